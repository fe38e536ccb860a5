"""How fast a column changes (MODEL.md, "Columns", "A package in time").

A column holds areal masses load[layer, node] in kg/m2; row 0 lies on the screen. Sub-models give
rates; one place here moves mass, `column_rates`, and every sum is kept to round-off.
"""

from vibroscreen.compiler.fours import all_four, four, four_in, larger, put_four, put_four_in, total
from vibroscreen.compiler.language import kernel, view2
from vibroscreen.kernels import state
from vibroscreen.kernels.numerics import blocks, reconstruction
from vibroscreen.kernels.physics import layer, passage, segregation

# A top layer below this part of a full one is no reason to cut an implicit step.
THIN = 1e-3


@kernel
def passage_factors(buffer, scene, load, lower, layers, cover, contact, factor):
    """P_i of the sizes in row 0 and their contact weights; fills the percolation too.

    `lower` are the loads as they are at the lower faces of the layers; in row 0 they are `load`.
    Returns rho_b u cover: of each size the rate rho_b u cover P_i contact_i, 1/s, passes of what
    row 0 holds, as F_0i = contact_i load_0i.
    """
    parameter, size = state.parameters(buffer), state.compact(buffer, 0)
    fraction, percolation = state.node_work(buffer, 2), state.percolation(buffer)
    model, own = parameter.segregation_model, state.extent(buffer).segregation_address
    segregation.segregate(model, own, size, lower, layers, scene, contact, percolation)
    for i in range(0, size.size, 4):
        put_four(fraction, i, four(contact, i) * four_in(load, 0, i))
    scene.cover = cover
    law, own = parameter.passage_law, state.extent(buffer).passage_address
    passage.passage_probability(law, own, size, fraction, scene, factor)
    return scene.density * scene.passage_velocity * cover


@kernel
def hand_down(change, row, i, flux):
    """What goes down from a layer, of four sizes: the row below gains it, this one begins so."""
    put_four_in(change, row - 1, i, four_in(change, row - 1, i) + flux)
    put_four_in(change, row, i, 0.0 - flux)


@kernel
def pass_through(load, contact, pace, weight, passing, change):
    """What passes out of the contact layer, by size into `passing`; its sum, kg/(m2 s).

    weight: P_i, and after it the rates of passage, 1/s.
    """
    passes = all_four(0.0)
    for i in range(0, passing.size, 4):
        rate = larger(0.0, four(weight, i)) * pace * four(contact, i)
        put_four(weight, i, rate)
        leaves = rate * four_in(load, 0, i)
        put_four(passing, i, leaves)
        put_four_in(change, 0, i, 0.0 - leaves)
        passes += leaves
    return total(passes)


@kernel
def column_rates(buffer, scene, now, layers, rate, moment):
    """Rates of change of a column, from block `now` into block `rate`, kg/(m2 s).

    Passage out of row 0, percolation with its return flow, settling (what passes is refilled from
    above, layer by layer), landing on the top layer `moment` s after the start. Layers exchange
    what they hold on the average, or with `bed.reconstruction` what they hold at the face.

    What settles out of a top layer that runs out has a composition that is 0/0 at its end, so the
    composition is followed beside the masses as x' = -percolation x + return flow, in the row above
    them; where something lands, a thin top layer has that of the start of the step.
    """
    load, change = blocks.stage_load(buffer, now), blocks.stage_load(buffer, rate)
    passing, weight = blocks.stage_passed(buffer, rate), state.node_work(buffer, 0)
    contact, percolation = state.node_work(buffer, 1), state.percolation(buffer)
    nodes = passing.size
    top = layer.layer_mass(load, layers - 1)
    upper = (layers - 2) * scene.layer_full
    scene.bed_load = top if layers == 1 else scene.contact_load + upper + top
    lower, upper = reconstruction.faces(buffer, load, layers)
    falling = blocks.follows_share(buffer, layers)
    cover = min(1.0, top / scene.contact_load) if layers == 1 else 1.0
    pace = passage_factors(buffer, scene, load, lower, layers, cover, contact, weight)
    lost = pass_through(load, contact, pace, weight, passing, change)
    full = scene.contact_load
    settling = lost / scene.layer_full
    for j in range(1, layers):
        if j < layers - 1 or (not falling and top > THIN * scene.layer_full):
            upward = layer.weighted_mass(lower, j, percolation, j) / full
            refill = settling if j < layers - 1 else lost / top
            for i in range(0, nodes, 4):
                flux = (four_in(percolation, j, i) + refill) * four_in(lower, j, i)
                flux -= upward * four_in(upper, j - 1, i)
                hand_down(change, j, i, flux)
        elif falling:
            share = blocks.stage_share(buffer, now, layers)
            share_change = blocks.stage_share(buffer, rate, layers)
            upward = layer.weighted_mass(share, 0, percolation, j) / full
            for i in range(0, nodes, 4):
                part = four_in(share, 0, i)
                gain = upward * four_in(upper, j - 1, i) - four_in(percolation, j, i) * part
                put_four_in(share_change, 0, i, gain)
                flux = lost * part - top * gain
                hand_down(change, j, i, flux)
        else:
            share = blocks.stage_share(buffer, blocks.NOW, layers)
            upward = layer.weighted_mass(lower, j, percolation, j) / full
            for i in range(0, nodes, 4):
                flux = four_in(percolation, j, i) * four_in(lower, j, i)
                flux -= upward * four_in(upper, j - 1, i)
                flux += lost * four_in(share, 0, i)
                hand_down(change, j, i, flux)
        full = scene.layer_full
    land(buffer, change, layers - 1, moment)
    state.counters(buffer).rates += 1.0


@kernel
def land(buffer, change, row, moment):
    """Add to a row what lands on it `moment` s after the start, kg/(m2 s)."""
    terms = state.work(buffer).source_terms
    if terms == 0:
        return
    source = state.source_now(buffer)
    if terms == 1:
        for i in range(change.shape[1]):
            change[row, i] += source[0, i]
    else:
        for i in range(change.shape[1]):
            change[row, i] += source[0, i] + moment * (source[1, i] + moment * source[2, i])


@kernel
def keep_top_share(buffer, layers):
    """Composition of the top layer at the start of a step."""
    share = blocks.stage_share(buffer, blocks.NOW, layers)
    load = blocks.stage_load(buffer, blocks.NOW)
    top = layer.layer_mass(load, layers - 1)
    below = max(0, layers - 2)
    row = layers - 1 if top > 0.0 else below
    mass = top if top > 0.0 else layer.layer_mass(load, below)
    scale = 1.0 / mass if mass > layer.NOTHING else 0.0
    for i in range(share.shape[1]):
        share[0, i] = scale * load[row, i]


@kernel
def fastest_rate(buffer, scene, layers):
    """Bound of the rates in the column, 1/s, as `column_rates` left them."""
    nodes = state.work(buffer).active
    fastest = blocks.largest_of(view2(buffer, int(buffer[state.AT.node_work]), 1, nodes), 0)
    percolation = state.percolation(buffer)
    if fastest == 0.0 and state.work(buffer).source_terms > 0.0:
        # An empty bed does not show how fast it will pass what lands on it.
        pace = scene.density * scene.passage_velocity / scene.contact_load
        fastest = pace * scene.open_area * (1.0 + scene.open_area)
    exchange = 0.0
    for j in range(1, layers):
        exchange = max(exchange, blocks.largest_of(percolation, j))
    return max(fastest + exchange, 3.0 * exchange)
