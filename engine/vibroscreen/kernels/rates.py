"""A column of the bed: its compact block, its layers, and how fast they change (MODEL.md,
"Columns", "A package in time").

A column holds areal masses load[layer, node] in kg/m2; row 0 lies on the screen. It is gathered
into a compact block without the sizes that take no part and scattered back. Sub-models give rates;
one place here moves mass, `column_rates`, and every sum is kept to round-off.
"""

from __future__ import annotations

from math import ceil

from vibroscreen.kernels import state
from vibroscreen.kernels.fours import (
    all_four,
    four,
    four_in,
    in_fours,
    larger,
    largest,
    put_four,
    put_four_in,
    total,
)
from vibroscreen.kernels.language import kernel, view1, view2
from vibroscreen.kernels.passage import BOUNCE, passage_probability
from vibroscreen.kernels.segregation import (
    CLASSIFIED,
    NOTHING,
    gap_of,
    layer_mass,
    segregate,
    weighted_mass,
)

# A layer is opened only for more than this part of a full one: round-off makes no layers.
SLIVER = 1e-9
# A top layer below this part of a full one is no reason to cut an implicit step.
THIN = 1e-3
# A size of which this part of the tolerance is left has passed.
USED_UP = 1e-4
# Proportions inside the sizes that move alike are equal up to this.
ALIKE = 1e-12
# Differences of a mass fraction below this bound no slope.
EVEN = 1e-14
# Blocks of `stage`: the column, the column at a stage, the rates at the stages, time integrals.
NOW, STAGED, K1, K2, K3, K4, K5, K6, K7, INTEGRAL = range(10)
# Blocks of `trial` while rates are found: loads at the faces of the layers.
LOWER, UPPER = 0, 1


# --- the compact column --------------------------------------------------------------------------
@kernel
def active_vector(buffer, at, row):
    """Row `row` of a field of vectors over the sizes that take part."""
    return state.vector(buffer, at, state.extent(buffer).active, row)


@kernel
def active_column(buffer, at):
    """A work column over the sizes that take part."""
    return view2(buffer, int(buffer[at]), state.extent(buffer).layers, state.extent(buffer).active)


@kernel
def block(buffer, at, index):
    """A block as one vector: what passed, the loads of the layers, the share of the top one."""
    rows = state.extent(buffer).layers + 2
    start = int(buffer[at]) + index * rows * in_fours(state.extent(buffer).nodes)
    return view1(buffer, start, rows * state.extent(buffer).active)


@kernel
def block_passed(buffer, at, index):
    """What passed, row 0 of a block."""
    rows = state.extent(buffer).layers + 2
    start = int(buffer[at]) + index * rows * in_fours(state.extent(buffer).nodes)
    return view1(buffer, start, state.extent(buffer).active)


@kernel
def block_load(buffer, at, index):
    """Loads of a block [layer, active size]."""
    rows = state.extent(buffer).layers + 2
    start = int(buffer[at]) + index * rows * in_fours(state.extent(buffer).nodes)
    start += state.extent(buffer).active
    return view2(buffer, start, rows - 2, state.extent(buffer).active)


@kernel
def block_share(buffer, at, index, layers):
    """Mass fractions of the top one of `layers` layers [1, active size]: the row above it."""
    rows, nodes = state.extent(buffer).layers + 2, state.extent(buffer).active
    start = int(buffer[at]) + index * rows * in_fours(state.extent(buffer).nodes)
    return view2(buffer, start + (layers + 1) * nodes, 1, nodes)


@kernel
def first_coarse(buffer, scene, load, layers):
    """First of the sizes that neither pass nor percolate and are mixed alike in all layers.

    They move alike as long as nothing lands on them, so one size carries them all (their mean).
    """
    size = state.node_vector(buffer, state.AT.size, 0)
    nodes = size.size
    parameter = state.parameters(buffer)
    model = parameter.segregation_model
    known = parameter.passage_law <= BOUNCE and model <= CLASSIFIED
    if state.switches(buffer).coarse_sizes == 0.0 or not known:
        return nodes
    if state.extent(buffer).source_terms > 0.0:
        return nodes
    closed = scene.aperture
    if state.extent(buffer).layered > 0.0:
        gap = gap_of(size[nodes - 1], scene.dilation, scene.relative_dilation)
        closed = max(closed, gap)
    first = nodes
    while first > 0 and size[first - 1] >= closed:
        first -= 1
    lowest = 0.0
    for i in range(first, nodes):
        lowest += load[0, i]
    for j in range(1, layers):
        mass = 0.0
        for i in range(first, nodes):
            mass += load[j, i]
        for i in range(first, nodes):
            if abs(load[j, i] * lowest - load[0, i] * mass) > ALIKE * lowest * mass:
                return nodes
    return first


@kernel
def gather(buffer, scene, load, reference, layers):
    """Copy a column into the block NOW without the sizes that take no part.

    Left out are sizes of which nothing is there or lands; what is left of a size that is used up
    passes at once; the coarse sizes that move alike become one. `place` says where a size is. Loops
    go over four sizes at once: the last one comes again, without mass, up to a multiple of four.
    """
    nodes = load.shape[1]
    switch = state.switches(buffer)
    counter = state.counters(buffer)
    tolerance = state.parameters(buffer).tolerance
    size = state.node_vector(buffer, state.AT.size, 0)
    held = state.node_vector(buffer, state.AT.node_work, 0)
    place = state.node_vector(buffer, state.AT.place, 0)
    share = state.node_vector(buffer, state.AT.share, 0)
    source = view2(buffer, int(buffer[state.AT.source]), 3, nodes)
    flux = state.node_vector(buffer, state.AT.column_flux, 0)
    terms = state.extent(buffer).source_terms
    passing = scene.passage_velocity > 0.0 and switch.used_up_sizes > 0.0 and terms == 0
    least = USED_UP * tolerance
    coarse = first_coarse(buffer, scene, load, layers)
    for i in range(nodes):
        held[i] = load[0, i]
    for j in range(1, layers):
        for i in range(nodes):
            held[i] += load[j, i]
    count = 0
    for i in range(coarse):
        if passing and 0.0 < held[i] < least * reference[i] and size[i] < scene.aperture:
            flux[i] += held[i]
            held[i] = 0.0
            for j in range(layers):
                load[j, i] = 0.0
            counter.used_up_sizes_skipped += 1.0
        lands = False
        for k in range(terms):
            lands = lands or source[k, i] != 0.0
        if held[i] > 0.0 or lands or switch.empty_sizes == 0.0:
            place[i] = count
            count += 1
        else:
            place[i] = -1.0
            counter.empty_sizes_skipped += 1.0
        share[i] = 1.0
    gathered, moment = 0.0, 0.0
    for i in range(coarse, nodes):
        gathered += held[i]
        moment += held[i] * size[i]
    for i in range(coarse, nodes):
        place[i] = count if gathered > 0.0 else -1.0
        share[i] = held[i] / gathered if gathered > 0.0 else 0.0
    if gathered > 0.0:
        counter.coarse_sizes_skipped += nodes - coarse - 1.0
    taking_part = max(1, count + (1 if gathered > 0.0 else 0))
    state.extent(buffer).active = in_fours(taking_part)
    fill_block(buffer, load, reference, layers, coarse)
    compact_size = active_vector(buffer, state.AT.compact, 0)
    if gathered > 0.0:
        compact_size[count] = moment / gathered
    for n in range(taking_part, compact_size.size):
        compact_size[n] = compact_size[taking_part - 1]
    return coarse


@kernel
def places_kept(place):
    """Number of the first sizes that have the same place in a block as in a column."""
    kept = 0
    while kept < place.size and place[kept] == kept:
        kept += 1
    return kept


@kernel
def fill_block(buffer, load, reference, layers, coarse):
    """Sizes, references, sources and loads of the sizes that take part into compact fields."""
    nodes = load.shape[1]
    count = state.extent(buffer).active
    size = state.node_vector(buffer, state.AT.size, 0)
    place = state.node_vector(buffer, state.AT.place, 0)
    source = view2(buffer, int(buffer[state.AT.source]), 3, nodes)
    compact_size = active_vector(buffer, state.AT.compact, 0)
    weight = active_vector(buffer, state.AT.compact, 1)
    landing = view2(buffer, int(buffer[state.AT.source_now]), 3, count)
    now, integral = block(buffer, state.AT.stage, NOW), block(buffer, state.AT.stage, INTEGRAL)
    terms = state.extent(buffer).source_terms
    rows_above = layers if terms == 0 else load.shape[0]
    for k in range((rows_above + 1) * count):
        now[k] = 0.0
        integral[k] = 0.0
    for n in range(count):
        weight[n] = 0.0
        compact_size[n] = 0.0
    for i in range(nodes):
        n = int(place[i])
        if n >= 0:
            compact_size[n] = size[i]
            weight[n] += reference[i]
    for n in range(count):
        weight[n] = 1.0 / weight[n] if weight[n] > NOTHING else 0.0
    for k in range(terms):
        for n in range(count):
            landing[k, n] = 0.0
        for i in range(nodes):
            n = int(place[i])
            if n >= 0:
                landing[k, n] = source[k, i]
    rows = block_load(buffer, state.AT.stage, NOW)
    straight = min(coarse, places_kept(place))
    for j in range(layers):
        for i in range(straight):
            rows[j, i] = load[j, i]
        for i in range(straight, coarse):
            n = int(place[i])
            if n >= 0:
                rows[j, n] = load[j, i]
        for i in range(coarse, nodes):
            n = int(place[i])
            if n >= 0:
                rows[j, n] += load[j, i]


@kernel
def scatter(buffer, load, layers, rows, elapsed):
    """Copy the block NOW back into a column of `rows` rows in use, and add its sums."""
    nodes = load.shape[1]
    place = state.node_vector(buffer, state.AT.place, 0)
    share = state.node_vector(buffer, state.AT.share, 0)
    now = block_load(buffer, state.AT.stage, NOW)
    integral = block_load(buffer, state.AT.stage, INTEGRAL)
    gone = block_passed(buffer, state.AT.stage, NOW)
    gone_time = block_passed(buffer, state.AT.stage, INTEGRAL)
    passed = state.node_vector(buffer, state.AT.column_flux, 0)
    passed_time = state.node_vector(buffer, state.AT.column_flux, 1)
    time = state.column(buffer, state.AT.column_time, 0)
    for i in range(nodes):
        passed_time[i] += elapsed * passed[i]
        n = int(place[i])
        if n < 0:
            continue
        passed[i] += share[i] * gone[n]
        passed_time[i] += share[i] * gone_time[n]
    # Most sizes keep their places: plain copies, which are fast.
    straight = places_kept(place)
    for j in range(rows):
        left = 1.0 if j < layers else 0.0
        for i in range(straight):
            load[j, i] = left * (share[i] * now[j, i])
            time[j, i] += share[i] * integral[j, i]
        for i in range(straight, nodes):
            n = int(place[i])
            if n >= 0:
                load[j, i] = left * (share[i] * now[j, n])
                time[j, i] += share[i] * integral[j, n]


# --- layers --------------------------------------------------------------------------------------
@kernel
def bed_load(load, layers):
    """Areal mass of a column, kg/m2."""
    mass = 0.0
    for j in range(layers):
        mass += layer_mass(load, j)
    return mass


@kernel
def layers_for(buffer, scene, mass):
    """Layers that a bed of `mass` kg/m2 has; sets the full load of an upper layer.

    A bed deeper than the layers can hold thickens the upper layers, never the contact layer.
    """
    scene.bed_load = mass
    scene.layer_full = scene.layer_load
    above = mass - scene.contact_load
    if state.extent(buffer).layered == 0.0 or above <= SLIVER * scene.layer_load:
        return 1
    most = state.extent(buffer).layers - 1
    if above > most * scene.layer_load * (1.0 + SLIVER):
        scene.layer_full = above / most
        return 1 + most
    return 1 + min(most, int(ceil(above / scene.layer_load - SLIVER)))


@kernel
def restack(buffer, scene, load, layers):
    """Settle: cut the column anew at the full loads of its layers; returns the number of layers.

    The stack keeps its order, so a layer is refilled with what lies right above it, and what does
    not fit into a layer goes to the one above. Rows that become free are zeroed.
    """
    wanted = layers_for(buffer, scene, bed_load(load, layers))
    if wanted == 1 and layers == 1:
        return 1
    nodes = load.shape[1]
    old = view2(buffer, int(buffer[state.AT.scratch]), load.shape[0], nodes)
    for j in range(layers):
        for i in range(nodes):
            old[j, i] = load[j, i]
    source = 0
    whole = layer_mass(old, 0)
    left = 1.0  # what remains of the layer `source`, as a part of it
    for j in range(wanted):
        need = scene.contact_load if j == 0 else scene.layer_full
        for i in range(nodes):
            load[j, i] = 0.0
        while source < layers:
            last = j == wanted - 1
            part = left
            if not last and whole * left > need:
                part = need / whole
            for i in range(nodes):
                load[j, i] += part * old[source, i]
            need -= part * whole
            if part < left:
                left -= part
                break
            source += 1
            left = 1.0
            if source < layers:
                whole = layer_mass(old, source)
            if need <= 0.0 and not last:
                break
    for j in range(wanted, layers):
        for i in range(nodes):
            load[j, i] = 0.0
    return wanted


# --- rates ---------------------------------------------------------------------------------------
@kernel
def passage_factors(buffer, scene, load, lower, layers, cover, contact, factor):
    """P_i of the sizes in row 0 and their contact weights; fills the percolation too.

    `lower` are the loads as they are at the lower faces of the layers; in row 0 they are `load`.
    Returns rho_b u cover: of each size the rate rho_b u cover P_i contact_i, 1/s, passes of what
    row 0 holds, as F_0i = contact_i load_0i.
    """
    parameter = state.parameters(buffer)
    size = active_vector(buffer, state.AT.compact, 0)
    fraction = active_vector(buffer, state.AT.node_work, 2)
    segregate(
        parameter.segregation_model,
        state.extent(buffer).segregation_address,
        size,
        lower,
        layers,
        scene,
        contact,
        active_column(buffer, state.AT.percolation),
    )
    for i in range(0, size.size, 4):
        put_four(fraction, i, four(contact, i) * four_in(load, 0, i))
    scene.cover = cover
    law = parameter.passage_law
    passage_probability(law, state.extent(buffer).passage_address, size, fraction, scene, factor)
    return scene.density * scene.passage_velocity * cover


@kernel
def cover_of(scene, mass):
    """Part of the deck that a contact layer of `mass` kg/m2 covers, min(1, sigma_0/sigma_c)."""
    return min(1.0, mass / scene.contact_load)


@kernel
def reconstructed(buffer):
    """Whether the composition inside a layer is linear."""
    return buffer[int(buffer[state.AT.reconstruction])] > 0.0


@kernel
def slope_factor(load, row, below, mass, above, share):
    """Theta of a layer: the part of the central slopes of its sizes that makes no new extremum.

    One for all sizes, so that the slopes sum up to zero and a full layer stays full at its faces.
    below, mass, above: of the three layers, kg/m2; share: span of the layer over that of the slope.
    """
    theta = 1.0
    a, b, c = 1.0 / below, 1.0 / mass, 1.0 / above
    for i in range(load.shape[1]):
        middle = b * load[row, i]
        down, up = middle - a * load[row - 1, i], c * load[row + 1, i] - middle
        least, most = min(abs(down), abs(up)), max(abs(down), abs(up))
        if most > EVEN:
            room = 2.0 * least if down * up > 0.0 else 0.0
            slope = share * abs(down + up)
            if theta * slope > room:
                theta = room / slope
    return theta


@kernel
def reconstruct(buffer, load, layers):
    """Loads as they are at the lower and upper faces of the layers, into two blocks of `trial`.

    Mass fractions are linear over a layer with a monotonised central slope, even in the contact
    layer and in the top one. The implicit scheme, whose blocks these are, does without.
    """
    lower = block_load(buffer, state.AT.trial, LOWER)
    upper = block_load(buffer, state.AT.trial, UPPER)
    nodes = load.shape[1]
    for i in range(nodes):
        lower[0, i] = upper[0, i] = load[0, i]
        lower[layers - 1, i] = upper[layers - 1, i] = load[layers - 1, i]
    below, mass = layer_mass(load, 0), layer_mass(load, 1)
    for j in range(1, layers - 1):
        above = layer_mass(load, j + 1)
        theta = 0.0
        if min(below, mass, above) > NOTHING:
            share = 2.0 * mass / (below + 2.0 * mass + above)
            theta = 0.5 * mass * share * slope_factor(load, j, below, mass, above, share)
        a, c = (theta / below, theta / above) if theta > 0.0 else (0.0, 0.0)
        for i in range(nodes):
            half = c * load[j + 1, i] - a * load[j - 1, i]
            lower[j, i], upper[j, i] = load[j, i] - half, load[j, i] + half
        below, mass = mass, above


@kernel
def hand_down(change, row, i, flux):
    """What goes down from a layer, of four sizes: the row below gains it, this one begins so."""
    put_four_in(change, row - 1, i, four_in(change, row - 1, i) + flux)
    put_four_in(change, row, i, 0.0 - flux)


@kernel
def column_rates(buffer, scene, at_now, now, layers, at_rate, rate, moment):
    """Rates of change of a column, from block `now` into block `rate`, kg/(m2 s).

    Passage out of row 0, percolation with its return flow, settling (what passes is refilled from
    above, layer by layer), landing on the top layer `moment` s after the start. Layers exchange
    what they hold on the average, or with `bed.reconstruction` what they hold at the face.

    What settles out of a top layer that runs out has a composition that is 0/0 at its end, so the
    composition is followed beside the masses as x' = -percolation x + return flow, in the row above
    them; where something lands, a thin top layer has that of the start of the step.
    """
    load, change = block_load(buffer, at_now, now), block_load(buffer, at_rate, rate)
    passing = block_passed(buffer, at_rate, rate)
    weight = active_vector(buffer, state.AT.node_work, 0)
    contact = active_vector(buffer, state.AT.node_work, 1)
    percolation = active_column(buffer, state.AT.percolation)
    nodes = passing.size
    top = layer_mass(load, layers - 1)
    upper = (layers - 2) * scene.layer_full
    scene.bed_load = top if layers == 1 else scene.contact_load + upper + top
    lower, upper = load, load
    if layers > 2 and reconstructed(buffer):
        reconstruct(buffer, load, layers)
        lower = block_load(buffer, state.AT.trial, LOWER)
        upper = block_load(buffer, state.AT.trial, UPPER)
    falling = follows_share(buffer, layers)
    cover = cover_of(scene, top) if layers == 1 else 1.0
    pace = passage_factors(buffer, scene, load, lower, layers, cover, contact, weight)
    passes = all_four(0.0)
    for i in range(0, nodes, 4):
        rate_of = larger(0.0, four(weight, i)) * pace * four(contact, i)
        put_four(weight, i, rate_of)
        leaves = rate_of * four_in(load, 0, i)
        put_four(passing, i, leaves)
        put_four_in(change, 0, i, 0.0 - leaves)
        passes += leaves
    lost = total(passes)
    full = scene.contact_load
    settling = lost / scene.layer_full
    for j in range(1, layers):
        if j < layers - 1 or (not falling and top > THIN * scene.layer_full):
            upward = weighted_mass(lower, j, percolation, j) / full
            refill = settling if j < layers - 1 else lost / top
            for i in range(0, nodes, 4):
                flux = (four_in(percolation, j, i) + refill) * four_in(lower, j, i)
                flux -= upward * four_in(upper, j - 1, i)
                hand_down(change, j, i, flux)
        elif falling:
            share = block_share(buffer, at_now, now, layers)
            share_change = block_share(buffer, at_rate, rate, layers)
            upward = weighted_mass(share, 0, percolation, j) / full
            for i in range(0, nodes, 4):
                part = four_in(share, 0, i)
                gain = upward * four_in(upper, j - 1, i) - four_in(percolation, j, i) * part
                put_four_in(share_change, 0, i, gain)
                flux = lost * part - top * gain
                hand_down(change, j, i, flux)
        else:
            share = block_share(buffer, state.AT.stage, NOW, layers)
            upward = weighted_mass(lower, j, percolation, j) / full
            for i in range(0, nodes, 4):
                flux = four_in(percolation, j, i) * four_in(lower, j, i)
                flux -= upward * four_in(upper, j - 1, i)
                flux += lost * four_in(share, 0, i)
                hand_down(change, j, i, flux)
        full = scene.layer_full
    land(buffer, change, layers - 1, moment)
    state.counters(buffer).rates += 1.0
    return lost


@kernel
def follows_share(buffer, layers):
    """Whether the composition of the top layer is followed beside its masses."""
    return layers > 1 and state.extent(buffer).source_terms == 0.0


@kernel
def rows_followed(buffer, layers):
    """Length of the part of a block that a scheme advances."""
    return (layers + (2 if follows_share(buffer, layers) else 1)) * state.extent(buffer).active


@kernel
def land(buffer, change, row, moment):
    """Add to a row what lands on it `moment` s after the start, kg/(m2 s)."""
    terms = state.extent(buffer).source_terms
    if terms == 0:
        return
    source = view2(buffer, int(buffer[state.AT.source_now]), 3, change.shape[1])
    if terms == 1:
        for i in range(change.shape[1]):
            change[row, i] += source[0, i]
    else:
        for i in range(change.shape[1]):
            change[row, i] += source[0, i] + moment * (source[1, i] + moment * source[2, i])


@kernel
def keep_top_share(buffer, layers):
    """Composition of the top layer at the start of a step."""
    share = block_share(buffer, state.AT.stage, NOW, layers)
    load = block_load(buffer, state.AT.stage, NOW)
    top = layer_mass(load, layers - 1)
    below = max(0, layers - 2)
    row = layers - 1 if top > 0.0 else below
    mass = top if top > 0.0 else layer_mass(load, below)
    scale = 1.0 / mass if mass > NOTHING else 0.0
    for i in range(share.shape[1]):
        share[0, i] = scale * load[row, i]


@kernel
def fastest_rate(buffer, scene, layers):
    """Bound of the rates in the column, 1/s, as `column_rates` left them."""
    nodes = state.extent(buffer).active
    fastest = largest_of(view2(buffer, int(buffer[state.AT.node_work]), 1, nodes), 0)
    percolation = active_column(buffer, state.AT.percolation)
    if fastest == 0.0 and state.extent(buffer).source_terms > 0.0:
        # An empty bed does not show how fast it will pass what lands on it.
        pace = scene.density * scene.passage_velocity / scene.contact_load
        fastest = pace * scene.open_area * (1.0 + scene.open_area)
    exchange = 0.0
    for j in range(1, layers):
        exchange = max(exchange, largest_of(percolation, j))
    return max(fastest + exchange, 3.0 * exchange)


@kernel
def close_sizes(buffer, load, before, layers, moment, elapsed):
    """Put what the steps of a block rounded away of a size into the row that holds most of it.

    `load` in `before` layers is the column at the start of the block, `moment`. The round-off of a
    step is that of the rates times h, so in a bed where all is in balance it is the same in every
    step: it would add up over many.
    """
    nodes = state.extent(buffer).active
    place = state.node_vector(buffer, state.AT.place, 0)
    missing = active_vector(buffer, state.AT.node_work, 1)
    values = block(buffer, state.AT.stage, NOW)
    for n in range(nodes):
        missing[n] = 0.0
    straight = places_kept(place)
    for j in range(before):
        for i in range(straight):
            missing[i] += load[j, i]
        for i in range(straight, load.shape[1]):
            n = int(place[i])
            if n >= 0:
                missing[n] += load[j, i]
    terms = state.extent(buffer).source_terms
    if terms > 0:
        source = view2(buffer, int(buffer[state.AT.source_now]), 3, nodes)
        for n in range(nodes):
            missing[n] += elapsed * mean_landing(source, n, terms, elapsed, moment)
    for row in range(layers + 1):
        start = row * nodes
        for n in range(nodes):
            missing[n] -= values[start + n]
    for n in range(nodes):
        if missing[n] != 0.0:
            most = n
            for row in range(1, layers + 1):
                if values[row * nodes + n] > values[most]:
                    most = row * nodes + n
            values[most] += missing[n]


@kernel
def mean_landing(source, i, terms, h, moment):
    """Mean of what lands of a size in a step of h that starts at `moment`, kg/(m2 s)."""
    if terms == 1:
        return source[0, i]
    middle = moment + 0.5 * h
    return source[0, i] + middle * source[1, i] + (middle * middle + h * h / 12.0) * source[2, i]


@kernel
def worst_of(error, weight):
    """Largest product of two vectors over the sizes that take part, not below 0."""
    worst = all_four(0.0)
    for i in range(0, error.size, 4):
        worst = larger(worst, four(error, i) * four(weight, i))
    return largest(worst)


@kernel
def largest_of(values, row):
    """Largest number of a row over the sizes that take part, not below 0."""
    most = all_four(0.0)
    for i in range(0, values.shape[1], 4):
        most = larger(most, four_in(values, row, i))
    return largest(most)
