"""A column of the bed for the schemes: the sizes that take part, in blocks (MODEL.md, "Rates")."""

from vibroscreen.compiler.fours import in_fours
from vibroscreen.compiler.language import kernel, view2
from vibroscreen.kernels import state
from vibroscreen.kernels.numerics import blocks, vectors
from vibroscreen.kernels.physics import layer, packing, passage, segregation

# A size of which this part of the tolerance is left has passed.
USED_UP = 1e-4
# Proportions inside the sizes that move alike are equal up to this.
ALIKE = 1e-12


@kernel
def first_coarse(buffer, scene, load, layers):
    """First of the sizes that neither pass nor percolate and are mixed alike in all layers.

    They move alike as long as nothing lands on them, so one size carries them all (their mean).
    """
    size, parameter = state.size(buffer), state.parameters(buffer)
    nodes, model = size.size, parameter.segregation_model
    known = parameter.passage_law <= passage.BOUNCE and model <= segregation.CLASSIFIED
    on = state.switches(buffer).coarse_sizes > 0.0 and state.work(buffer).source_terms == 0
    if not (known and on):
        return nodes
    closed = scene.closed
    if state.extent(buffer).layered > 0.0:
        gap = packing.gap_of(size[nodes - 1], scene.dilation, scene.relative_dilation)
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
def join_coarse(held, size, coarse, count, place, share):
    """Sizes from `coarse` on become one, the next one of the block; its mass and first moment."""
    gathered, moment = 0.0, 0.0
    for i in range(coarse, held.size):
        gathered += held[i]
        moment += held[i] * size[i]
    for i in range(coarse, held.size):
        place[i] = count if gathered > 0.0 else -1.0
        share[i] = held[i] / gathered if gathered > 0.0 else 0.0
    return gathered, moment


@kernel
def gather(buffer, scene, load, reference, layers):
    """Copy a column into the block NOW without the sizes that take no part.

    Left out are sizes of which nothing is there or lands; what is left of a size that is used up
    passes at once; the coarse sizes that move alike become one. `place` says where a size is. Loops
    go over four sizes at once: the last one comes again, without mass, up to a multiple of four.
    """
    switch, counter = state.switches(buffer), state.counters(buffer)
    size, held = state.size(buffer), state.spare(buffer, 0)
    place, share = state.place(buffer), state.share(buffer)
    source, flux = state.source(buffer), state.column_flux(buffer, 0)
    terms = state.work(buffer).source_terms
    passing = scene.passage_velocity > 0.0 and switch.used_up_sizes > 0.0 and terms == 0
    least = USED_UP * state.parameters(buffer).solver_tolerance
    coarse = first_coarse(buffer, scene, load, layers)
    vectors.fill(held, 0.0)
    vectors.add_rows(held, 1.0, load, layers)
    count = 0
    for i in range(coarse):
        if passing and 0.0 < held[i] < least * reference[i] and size[i] < scene.closed:
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
    gathered, moment = join_coarse(held, size, coarse, count, place, share)
    if gathered > 0.0:
        counter.coarse_sizes_skipped += size.size - coarse - 1.0
    taking_part = max(1, count + (1 if gathered > 0.0 else 0))
    state.work(buffer).active = in_fours(taking_part)
    fill_block(buffer, load, reference, layers)
    compact_size = state.compact(buffer, 0)
    if gathered > 0.0:
        compact_size[count] = moment / gathered
    for n in range(taking_part, compact_size.size):
        compact_size[n] = compact_size[taking_part - 1]


@kernel
def places_kept(place):
    """Number of the first sizes that have the same place in a block as in a column."""
    kept = 0
    while kept < place.size and place[kept] == kept:
        kept += 1
    return kept


@kernel
def gather_row(place, straight, load, row, to, to_row):
    """Add a row of a column to one of a block; the first `straight` sizes keep their places."""
    for i in range(straight):
        to[to_row, i] += load[row, i]
    for i in range(straight, place.size):
        n = int(place[i])
        if n >= 0:
            to[to_row, n] += load[row, i]


@kernel
def fill_block(buffer, load, reference, layers):
    """Sizes, references, sources and loads of the sizes that take part into compact fields."""
    count, terms = state.work(buffer).active, state.work(buffer).source_terms
    size, place = state.size(buffer), state.place(buffer)
    compact_size, weight = state.compact(buffer, 0), state.compact(buffer, 1)
    now, integral = blocks.stage(buffer, blocks.NOW), blocks.stage(buffer, blocks.INTEGRAL)
    rows_above = layers if terms == 0 else load.shape[0]
    for k in range((rows_above + 1) * count):
        now[k], integral[k] = 0.0, 0.0
    vectors.fill(weight, 0.0)
    vectors.fill(compact_size, 0.0)
    for i in range(place.size):
        n = int(place[i])
        if n >= 0:
            compact_size[n] = size[i]
            weight[n] += reference[i]
    for n in range(count):
        weight[n] = 1.0 / weight[n] if weight[n] > layer.NOTHING else 0.0
    straight = places_kept(place)
    source, landing = state.source(buffer), state.source_now(buffer)
    vectors.clear_rows(landing, 0, terms)
    for k in range(terms):
        gather_row(place, straight, source, k, landing, k)
    rows = blocks.stage_load(buffer, blocks.NOW)
    for j in range(layers):
        gather_row(place, straight, load, j, rows, j)


@kernel
def add_spread(buffer, straight, to, load, rows):
    """Add the rows of a block to those of a column; the first `straight` sizes keep their places.

    Those are most: plain sums, which are fast.
    """
    place, share = state.place(buffer), state.share(buffer)
    for j in range(rows):
        for i in range(straight):
            to[j, i] += share[i] * load[j, i]
        for i in range(straight, place.size):
            n = int(place[i])
            if n >= 0:
                to[j, i] += share[i] * load[j, n]


@kernel
def scatter(buffer, load, layers, rows, elapsed):
    """Copy the block NOW back into a column of `rows` rows in use, and add its sums."""
    place, share = state.place(buffer), state.share(buffer)
    gone = blocks.stage_passed(buffer, blocks.NOW)
    gone_time, passed = blocks.stage_passed(buffer, blocks.INTEGRAL), state.column_flux(buffer, 0)
    passed_time = state.column_flux(buffer, 1)
    for i in range(passed.size):
        passed_time[i] += elapsed * passed[i]
        n = int(place[i])
        if n >= 0:
            passed[i] += share[i] * gone[n]
            passed_time[i] += share[i] * gone_time[n]
    straight = places_kept(place)
    vectors.clear_rows(load, 0, rows)
    add_spread(buffer, straight, load, blocks.stage_load(buffer, blocks.NOW), layers)
    time = state.column_time(buffer)
    add_spread(buffer, straight, time, blocks.stage_load(buffer, blocks.INTEGRAL), rows)


@kernel
def close_sizes(buffer, load, before, layers, moment, elapsed):
    """Put what the steps of a block rounded away of a size into the row that holds most of it.

    `load` in `before` layers is the column at the start of the block, `moment`. The round-off of a
    step is that of the rates times h, so in a bed where all is in balance it is the same in every
    step: it would add up over many.
    """
    nodes, terms = state.work(buffer).active, state.work(buffer).source_terms
    place = state.place(buffer)
    straight = places_kept(place)
    values, missing = blocks.stage(buffer, blocks.NOW), state.node_work(buffer, 1)
    sums = view2(buffer, int(buffer[state.AT.node_work]) + nodes, 1, nodes)  # the same numbers
    vectors.fill(missing, 0.0)
    for j in range(before):
        gather_row(place, straight, load, j, sums, 0)
    if terms > 0:
        source = state.source_now(buffer)
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
