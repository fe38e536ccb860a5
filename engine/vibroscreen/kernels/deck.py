"""Packages on a deck: entry, transport, discharge, merging (MODEL.md, "The deck").

A deck holds two rows of packages, by position from the discharge to the feed end:
  the queue: packages with a history of their own, first to be discharged first;
  the cohort: all that entered since motion, material and feed last changed. Its slices share one
      trajectory, so its cells [k d, (k+1) d] hold the same at any time, and only its leading
      slice (`lead`) is integrated. When it reaches the discharge the deck is steady.
When something changes, the cohort joins the queue and a new one begins. Loads are in kg/m2, a
package keeps its length while it rides, so mass = width x length x load is moved, never made.
Where the deck stands still (or creeps) the feed lands on top of a pile of the least length.
"""

from __future__ import annotations

from vibroscreen.kernels.jit import inlined, kernel
from vibroscreen.kernels.layout import (
    AT_CELL,
    AT_COLUMN_FLUX,
    AT_COLUMN_TIME,
    AT_COUNTER,
    AT_FEED_FRACTION,
    AT_FREE,
    AT_LAYERS_USED,
    AT_LEAD,
    AT_LEAD_FEED,
    AT_LEAD_PASSED,
    AT_LENGTH,
    AT_LOAD,
    AT_PACE,
    AT_PARAMETER,
    AT_PARTIAL,
    AT_QUEUE,
    AT_REFERENCE,
    AT_SCENE,
    AT_SOURCE,
    AT_STEP_MASS,
    AT_WIDTH,
    BED_LAYERS,
    C_MERGES,
    C_PACKAGES,
    C_PACKAGES_SKIPPED,
    COUNTER,
    D_CAPACITY_ALARM,
    D_CELLS,
    D_COHORT_FED,
    D_COHORT_FRONT,
    D_COVERED,
    D_LEAD_LAYERS,
    D_ORDER,
    D_PACE,
    D_PACKAGES,
    D_PARTIAL_LAYERS,
    D_PILE_OPEN,
    D_PILE_REAR,
    D_STEP,
    D_WIDE,
    LAYERED,
    LENGTH,
    N_CELLS,
    N_DECKS,
    N_PACKAGES,
    N_PANELS,
    N_SOURCE,
    PARAMETER,
    S_CONTACT_LOAD,
    S_DENSITY,
    S_LAYER_LOAD,
    S_PASSAGE_VELOCITY,
    S_SEGREGATION_VELOCITY,
    S_TRANSPORT_VELOCITY,
    TOLERANCE,
    column,
    deck_vector,
    node_vector,
    package_vector,
    panel_vector,
    scene_vector,
    slot,
    vector,
)
from vibroscreen.kernels.package import bed_load, integrate, restack

# A feed piles up where it would lie deeper than this part of the deck's length.
PILE_DEPTH = 0.5
# A package moved by less than this part of a length has moved by round-off.
MOMENT = 1e-9
# Two pieces become one package up to this part over the length of a cell.
JOIN = 1.0 + 1e-9


@kernel
def deck_width(buffer, deck):
    """Width of a deck, m."""
    return vector(buffer, AT_WIDTH, int(buffer[N_DECKS]), 0)[deck]


@kernel
def deck_length(buffer, deck):
    """Length of a deck, m."""
    length = 0.0
    for panel in range(int(buffer[N_PANELS])):
        length += panel_vector(buffer, deck, panel)[LENGTH]
    return length


@kernel
def cell_length(buffer, deck):
    """Length of a cell of the cohort, the longest package, and of a pile, m."""
    return deck_length(buffer, deck) / int(buffer[N_CELLS])


@kernel
def residence_time(buffer, deck, scene):
    """Time from the feed end to the discharge, s; 0 where the deck does not convey."""
    velocity = scene[S_TRANSPORT_VELOCITY]
    return deck_length(buffer, deck) / velocity if velocity > 0.0 else 0.0


@kernel
def bed_capacity(buffer, deck):
    """Depth that `bed.layers` layers together hold, m; also where a model has none of its own."""
    scene = scene_vector(buffer, AT_SCENE, deck, 0)
    upper = (buffer[BED_LAYERS] - 1.0) * scene[S_LAYER_LOAD]
    return (scene[S_CONTACT_LOAD] + upper) / scene[S_DENSITY]


@kernel
def clear_deck(buffer, deck):
    """An empty deck: all slots free, no cohort."""
    book = deck_vector(buffer, deck)
    for i in range(book.size):
        book[i] = 0.0
    free = package_vector(buffer, AT_FREE, deck)
    for index in range(free.size):
        free[index] = free.size - 1 - index


# --- slots -------------------------------------------------------------------------------------
@kernel
def free_slots(buffer, deck):
    """Number of package slots that nobody uses."""
    book = deck_vector(buffer, deck)
    return int(buffer[N_PACKAGES] - book[D_PACKAGES] - book[D_CELLS])


@kernel
def give_back(buffer, deck, index):
    """Put slot `index` on the pile of free ones; call before the package leaves its row."""
    package_vector(buffer, AT_FREE, deck)[free_slots(buffer, deck)] = index


@kernel
def new_slot(buffer, deck):
    """A free slot, emptied; merges neighbours of the queue if there is none."""
    if free_slots(buffer, deck) == 0:
        merge_likest(buffer, deck)
    index = int(package_vector(buffer, AT_FREE, deck)[free_slots(buffer, deck) - 1])
    whole = slot(buffer, deck, index)
    load = column(buffer, AT_LOAD, whole)
    reference = node_vector(buffer, AT_REFERENCE, whole)
    for i in range(reference.size):
        reference[i] = 0.0
        for j in range(load.shape[0]):
            load[j, i] = 0.0
    package_vector(buffer, AT_LENGTH, deck)[index] = 0.0
    package_vector(buffer, AT_LAYERS_USED, deck)[index] = 1.0
    pace = vector(buffer, AT_PACE, 4, whole)
    book = deck_vector(buffer, deck)
    keep_pace(book, pace)
    return index


@inlined
def keep_pace(book, pace):
    """Remember steps and order of the integration with a package."""
    pace[0], pace[1], pace[2], pace[3] = book[D_STEP], book[D_ORDER], book[D_PACE], book[D_WIDE]


@inlined
def use_pace(book, pace):
    """Go on with remembered steps and order."""
    book[D_STEP], book[D_ORDER], book[D_PACE], book[D_WIDE] = pace[0], pace[1], pace[2], pace[3]


@kernel
def queue_slot(buffer, deck, place):
    """Slot of the package at a place of the queue."""
    return int(package_vector(buffer, AT_QUEUE, deck)[place])


@kernel
def leave_queue(buffer, deck, place):
    """Take the package at `place` out of the queue and free its slot."""
    book = deck_vector(buffer, deck)
    queue = package_vector(buffer, AT_QUEUE, deck)
    give_back(buffer, deck, queue[place])
    book[D_PACKAGES] -= 1.0
    for k in range(place, int(book[D_PACKAGES])):
        queue[k] = queue[k + 1]


@kernel
def merge_into(buffer, deck, place):
    """Merge the package behind `place` into the one at `place`, layer by layer, conservatively."""
    scene = scene_vector(buffer, AT_SCENE, deck, 0)
    keep, gone = queue_slot(buffer, deck, place), queue_slot(buffer, deck, place + 1)
    length = package_vector(buffer, AT_LENGTH, deck)
    used = package_vector(buffer, AT_LAYERS_USED, deck)
    whole = length[keep] + length[gone]
    if whole > 0.0:
        load, more = (
            column(buffer, AT_LOAD, slot(buffer, deck, keep)),
            column(buffer, AT_LOAD, slot(buffer, deck, gone)),
        )
        reference = node_vector(buffer, AT_REFERENCE, slot(buffer, deck, keep))
        fed = node_vector(buffer, AT_REFERENCE, slot(buffer, deck, gone))
        layers = int(max(used[keep], used[gone]))
        for i in range(reference.size):
            reference[i] = (length[keep] * reference[i] + length[gone] * fed[i]) / whole
            for j in range(layers):
                load[j, i] = (length[keep] * load[j, i] + length[gone] * more[j, i]) / whole
        used[keep] = restack(buffer, scene, load, layers)
        length[keep] = whole
    leave_queue(buffer, deck, place + 1)
    vector(buffer, AT_COUNTER, len(COUNTER), 0)[C_MERGES] += 1.0


@kernel
def unlikeness(buffer, deck, one, two):
    """How much two packages differ: largest difference of a node, as a part of what was fed."""
    used = package_vector(buffer, AT_LAYERS_USED, deck)
    load = column(buffer, AT_LOAD, slot(buffer, deck, one))
    other = column(buffer, AT_LOAD, slot(buffer, deck, two))
    reference = node_vector(buffer, AT_REFERENCE, slot(buffer, deck, one))
    fed = node_vector(buffer, AT_REFERENCE, slot(buffer, deck, two))
    layers = int(max(used[one], used[two]))
    worst = 0.0
    for i in range(reference.size):
        difference = 0.0
        for j in range(layers):
            difference += load[j, i] - other[j, i]
        scale = max(reference[i], fed[i])
        if scale > 0.0:
            worst = max(worst, abs(difference) / scale)
    return worst


@kernel
def merge_likest(buffer, deck):
    """Merge the two neighbours whose mixing matters least; says so where it matters.

    Rates are smooth, so what mixing changes is of second order in the difference.
    """
    book = deck_vector(buffer, deck)
    length = package_vector(buffer, AT_LENGTH, deck)
    best, least = 0, 1e300
    for place in range(int(book[D_PACKAGES]) - 1):
        one, two = queue_slot(buffer, deck, place), queue_slot(buffer, deck, place + 1)
        together = length[one] + length[two]
        weight = length[one] * length[two] / together if together > 0.0 else 0.0
        # Length breaks the tie of packages that are alike.
        cost = unlikeness(buffer, deck, one, two) ** 2 * weight + 1e-12 * together
        if cost < least:
            best, least = place, cost
    one, two = queue_slot(buffer, deck, best), queue_slot(buffer, deck, best + 1)
    if not alike(buffer, deck, one, two):
        book[D_CAPACITY_ALARM] = 1.0
    merge_into(buffer, deck, best)


@kernel
def alike(buffer, deck, one, two):
    """Whether mixing two packages changes a recovery by less than the tolerance."""
    tolerance = vector(buffer, AT_PARAMETER, len(PARAMETER), 0)[TOLERANCE]
    return unlikeness(buffer, deck, one, two) ** 2 <= tolerance


# --- the queue ---------------------------------------------------------------------------------
@inlined
def integrate_package(buffer, deck, index, duration):
    """Advance the column of a package; its step and order are remembered with it."""
    book = deck_vector(buffer, deck)
    whole = slot(buffer, deck, index)
    pace = vector(buffer, AT_PACE, 4, whole)
    lead_pace = (book[D_STEP], book[D_ORDER], book[D_PACE], book[D_WIDE])
    use_pace(book, pace)
    used = package_vector(buffer, AT_LAYERS_USED, deck)
    used[index] = integrate(
        buffer,
        scene_vector(buffer, AT_SCENE, deck, 0),
        book,
        column(buffer, AT_LOAD, whole),
        node_vector(buffer, AT_REFERENCE, whole),
        int(used[index]),
        duration,
    )
    keep_pace(book, pace)
    use_pace(book, lead_pace)
    vector(buffer, AT_COUNTER, len(COUNTER), 0)[C_PACKAGES] += 1.0


@inlined
def ride(buffer, deck, index, duration):
    """Let a package lie on the deck as a whole for `duration` s; what passes is undersize."""
    if duration <= 0.0:
        return
    integrate_package(buffer, deck, index, duration)
    area = deck_width(buffer, deck) * package_vector(buffer, AT_LENGTH, deck)[index]
    undersize = node_vector(buffer, AT_STEP_MASS, 0)
    passed = node_vector(buffer, AT_COLUMN_FLUX, 0)
    for i in range(passed.size):
        undersize[i] += area * passed[i]


@inlined
def discharge(buffer, deck, index, duration, rest):
    """Shorten a package to the length `rest` over the deck's end, evenly in `duration` s.

    With length l(t): undersize W integral of l dp, oversize W integral of load (-dl); both follow
    exactly from the time integrals of what passed and of the loads.
    """
    length = package_vector(buffer, AT_LENGTH, deck)
    integrate_package(buffer, deck, index, duration)
    width = deck_width(buffer, deck)
    shed = (length[index] - rest) / duration
    undersize, oversize = node_vector(buffer, AT_STEP_MASS, 0), node_vector(buffer, AT_STEP_MASS, 1)
    passed, passed_time = (
        node_vector(buffer, AT_COLUMN_FLUX, 0),
        node_vector(buffer, AT_COLUMN_FLUX, 1),
    )
    time = column(buffer, AT_COLUMN_TIME, 0)
    for i in range(passed.size):
        undersize[i] += width * (rest * passed[i] + shed * passed_time[i])
        lay = 0.0
        for j in range(time.shape[0]):
            lay += time[j, i]
        oversize[i] += width * shed * lay
    length[index] = rest


@kernel
def idle(buffer, deck, index):
    """Whether nothing can happen inside a package: it is empty, or the deck is at rest."""
    scene = scene_vector(buffer, AT_SCENE, deck, 0)
    if scene[S_PASSAGE_VELOCITY] == 0.0 and scene[S_SEGREGATION_VELOCITY] == 0.0:
        return scene[S_TRANSPORT_VELOCITY] == 0.0
    used = int(package_vector(buffer, AT_LAYERS_USED, deck)[index])
    return bed_load(column(buffer, AT_LOAD, slot(buffer, deck, index)), used) == 0.0


@kernel
def shed(buffer, deck, index):
    """Let what is left of a package fall over the deck's end at once."""
    load = column(buffer, AT_LOAD, slot(buffer, deck, index))
    length = package_vector(buffer, AT_LENGTH, deck)
    area = deck_width(buffer, deck) * length[index]
    oversize = node_vector(buffer, AT_STEP_MASS, 1)
    for j in range(int(package_vector(buffer, AT_LAYERS_USED, deck)[index])):
        for i in range(oversize.size):
            oversize[i] += area * load[j, i]
    length[index] = 0.0


@inlined
def advance_package(buffer, deck, index, rear, duration):
    """Move a package whose rear is at `rear` for `duration` s; returns its length on the deck."""
    length = package_vector(buffer, AT_LENGTH, deck)
    end = deck_length(buffer, deck)
    velocity = scene_vector(buffer, AT_SCENE, deck, 0)[S_TRANSPORT_VELOCITY]
    whole, over = duration, 0.0  # time as a whole on the deck, then while it is discharged
    rest = length[index]
    if velocity > 0.0:
        whole = min(duration, max(0.0, (end - rear - length[index]) / velocity))
        if whole < MOMENT * length[index] / velocity:
            whole = 0.0
        over = min(duration, max(0.0, (end - rear) / velocity)) - whole
        rest = min(rest, end - rear - velocity * duration)
        if rest < MOMENT * cell_length(buffer, deck):
            rest = 0.0
    if idle(buffer, deck, index):
        vector(buffer, AT_COUNTER, len(COUNTER), 0)[C_PACKAGES_SKIPPED] += 1.0
        if rest == 0.0:
            shed(buffer, deck, index)
        length[index] = rest
        return rest
    ride(buffer, deck, index, whole)
    if rest < length[index] and over > 0.0:
        discharge(buffer, deck, index, over, rest)
    elif rest == 0.0:
        shed(buffer, deck, index)
    return rest


@inlined
def advance_queue(buffer, deck, duration):
    """Advance all packages of the queue, the one nearest to the discharge first."""
    book = deck_vector(buffer, deck)
    length = package_vector(buffer, AT_LENGTH, deck)
    velocity = scene_vector(buffer, AT_SCENE, deck, 0)[S_TRANSPORT_VELOCITY]
    source = node_vector(buffer, AT_SOURCE, 0)
    rear = book[D_PILE_REAR] if book[D_PILE_OPEN] > 0.0 else book[D_COHORT_FRONT]
    count = int(book[D_PACKAGES])
    for place in range(count - 1, 0, -1):
        rear += length[queue_slot(buffer, deck, place)]
    gone = 0
    for place in range(count):
        index = queue_slot(buffer, deck, place)
        pile = place == count - 1 and book[D_PILE_OPEN] > 0.0
        behind = length[queue_slot(buffer, deck, place + 1)] if place + 1 < count else 0.0
        if pile:
            feed_pile(buffer, deck, index, duration)
            ride(buffer, deck, index, duration)
            buffer[N_SOURCE] = 0.0
        elif advance_package(buffer, deck, index, rear, duration) <= 0.0 and place == gone:
            gone += 1
        rear -= behind
    for _ in range(gone):
        leave_queue(buffer, deck, 0)
    if book[D_PILE_OPEN] > 0.0:
        book[D_PILE_REAR] += velocity * duration


# --- the pile ----------------------------------------------------------------------------------
@inlined
def open_pile(buffer, deck):
    """Begin a package on which the feed lands until it has moved by its own length."""
    book = deck_vector(buffer, deck)
    join_queue(buffer, deck)
    index = new_slot(buffer, deck)
    length = cell_length(buffer, deck)
    package_vector(buffer, AT_LENGTH, deck)[index] = length
    package_vector(buffer, AT_QUEUE, deck)[int(book[D_PACKAGES])] = index
    book[D_PACKAGES] += 1.0
    book[D_PILE_OPEN], book[D_PILE_REAR] = 1.0, -length


@kernel
def feed_pile(buffer, deck, index, duration):
    """Set the feed as a source on top of the pile, kg/(m2 s)."""
    source = node_vector(buffer, AT_SOURCE, 0)
    reference = node_vector(buffer, AT_REFERENCE, slot(buffer, deck, index))
    area = deck_width(buffer, deck) * package_vector(buffer, AT_LENGTH, deck)[index]
    rate = deck_vector(buffer, deck)[D_COHORT_FED]
    fraction = node_vector(buffer, AT_FEED_FRACTION, 0)
    buffer[N_SOURCE] = 1.0
    for i in range(source.size):
        source[i] = rate * fraction[i] / area
        reference[i] += source[i] * duration


# --- the cohort --------------------------------------------------------------------------------
@kernel
def start_cohort(buffer, deck, rate):
    """Let the slices that enter from now on share one trajectory; `rate` is the feed, kg/s."""
    book = deck_vector(buffer, deck)
    scene = scene_vector(buffer, AT_SCENE, deck, 0)
    lead, partial = column(buffer, AT_LEAD, deck), column(buffer, AT_PARTIAL, deck)
    fed = node_vector(buffer, AT_LEAD_FEED, deck)
    passed = node_vector(buffer, AT_LEAD_PASSED, deck)
    fraction = node_vector(buffer, AT_FEED_FRACTION, 0)
    velocity = scene[S_TRANSPORT_VELOCITY]
    load = rate / (deck_width(buffer, deck) * velocity) if velocity > 0.0 else 0.0
    for i in range(fed.size):
        fed[i] = load * fraction[i]
        passed[i] = 0.0
        for j in range(lead.shape[0]):
            lead[j, i] = 0.0
            partial[j, i] = 0.0
        lead[0, i] = fed[i]
    book[D_COHORT_FED], book[D_COHORT_FRONT], book[D_COVERED] = rate, 0.0, 0.0
    book[D_STEP], book[D_PACE], book[D_WIDE], book[D_PARTIAL_LAYERS] = 0.0, 0.0, 0.0, 1.0
    book[D_LEAD_LAYERS] = restack(buffer, scene, lead, 1)


@kernel
def join_queue(buffer, deck):
    """The cohort's cells join the queue as packages of their own; the cohort is empty after it."""
    book = deck_vector(buffer, deck)
    before = int(book[D_PACKAGES])
    piece = book[D_COHORT_FRONT]
    if book[D_COHORT_FED] > 0.0:
        piece -= book[D_CELLS] * cell_length(buffer, deck)
        if book[D_COVERED] > 0.0:
            piece = 0.0
    if piece > 0.0:
        append_piece(buffer, deck, piece)
    queue, cell = package_vector(buffer, AT_QUEUE, deck), package_vector(buffer, AT_CELL, deck)
    while book[D_CELLS] > 0.0:
        book[D_CELLS] -= 1.0
        queue[int(book[D_PACKAGES])] = cell[int(book[D_CELLS])]
        book[D_PACKAGES] += 1.0
    book[D_COHORT_FRONT], book[D_COVERED] = 0.0, 0.0
    if before > 0 and before < int(book[D_PACKAGES]):
        join_neighbours(buffer, deck, before - 1)


@kernel
def append_piece(buffer, deck, length):
    """Append the cohort's unfinished cell, or its empty stretch, `length` m long, to the queue."""
    book = deck_vector(buffer, deck)
    index = new_slot(buffer, deck)
    if book[D_COHORT_FED] > 0.0:
        finish_cell(buffer, deck, index, length)
    package_vector(buffer, AT_LENGTH, deck)[index] = length
    package_vector(buffer, AT_QUEUE, deck)[int(book[D_PACKAGES])] = index
    book[D_PACKAGES] += 1.0


@kernel
def join_neighbours(buffer, deck, place):
    """Merge the packages at `place` and behind it if they are short and alike, or both empty."""
    length = package_vector(buffer, AT_LENGTH, deck)
    one, two = queue_slot(buffer, deck, place), queue_slot(buffer, deck, place + 1)
    empty = package_load(buffer, deck, place) + package_load(buffer, deck, place + 1) == 0.0
    short = length[one] + length[two] <= cell_length(buffer, deck) * JOIN
    if empty or (short and alike(buffer, deck, one, two)):
        merge_into(buffer, deck, place)


@kernel
def finish_cell(buffer, deck, index, length):
    """Turn what the cohort's unfinished cell collected (kg/m) into a package of `length` m."""
    book = deck_vector(buffer, deck)
    partial = column(buffer, AT_PARTIAL, deck)
    whole = slot(buffer, deck, index)
    load = column(buffer, AT_LOAD, whole)
    fed = node_vector(buffer, AT_LEAD_FEED, deck)
    reference = node_vector(buffer, AT_REFERENCE, whole)
    layers = int(book[D_PARTIAL_LAYERS])
    for i in range(fed.size):
        reference[i] = fed[i]
        for j in range(layers):
            load[j, i] = partial[j, i] / length
            partial[j, i] = 0.0
    scene = scene_vector(buffer, AT_SCENE, deck, 0)
    package_vector(buffer, AT_LAYERS_USED, deck)[index] = restack(buffer, scene, load, layers)
    package_vector(buffer, AT_LENGTH, deck)[index] = length
    book[D_PARTIAL_LAYERS] = 1.0


@inlined
def advance_lead(buffer, deck, duration):
    """Advance the leading slice; the cohort behind it passes W v p(front) at any moment."""
    book = deck_vector(buffer, deck)
    scene = scene_vector(buffer, AT_SCENE, deck, 0)
    lead, partial = column(buffer, AT_LEAD, deck), column(buffer, AT_PARTIAL, deck)
    passed_before = node_vector(buffer, AT_LEAD_PASSED, deck)
    before = int(book[D_LEAD_LAYERS])
    fed = node_vector(buffer, AT_LEAD_FEED, deck)
    book[D_LEAD_LAYERS] = integrate(buffer, scene, book, lead, fed, before, duration)
    passed, passed_time = (
        node_vector(buffer, AT_COLUMN_FLUX, 0),
        node_vector(buffer, AT_COLUMN_FLUX, 1),
    )
    time = column(buffer, AT_COLUMN_TIME, 0)
    undersize = node_vector(buffer, AT_STEP_MASS, 0)
    velocity = scene[S_TRANSPORT_VELOCITY]
    area_rate = deck_width(buffer, deck) * velocity
    layers = int(max(book[D_PARTIAL_LAYERS], before, book[D_LEAD_LAYERS]))
    for i in range(fed.size):
        undersize[i] += area_rate * (passed_before[i] * duration + passed_time[i])
        passed_before[i] += passed[i]
        for j in range(layers):
            partial[j, i] += velocity * time[j, i]
    book[D_PARTIAL_LAYERS] = layers


@kernel
def stream_of_covered_deck(buffer, deck, duration):
    """Undersize and oversize where the cohort covers the deck: all rates are constant."""
    book = deck_vector(buffer, deck)
    if book[D_COHORT_FED] == 0.0:
        return
    velocity = scene_vector(buffer, AT_SCENE, deck, 0)[S_TRANSPORT_VELOCITY]
    carried = deck_width(buffer, deck) * velocity * duration
    undersize, oversize = node_vector(buffer, AT_STEP_MASS, 0), node_vector(buffer, AT_STEP_MASS, 1)
    passed, lead = node_vector(buffer, AT_LEAD_PASSED, deck), column(buffer, AT_LEAD, deck)
    if buffer[LAYERED] > 0.0 and depth_at_feed(buffer, deck) > bed_capacity(buffer, deck):
        book[D_CAPACITY_ALARM] = 1.0
    for i in range(passed.size):
        undersize[i] += carried * passed[i]
        for j in range(int(book[D_LEAD_LAYERS])):
            oversize[i] += carried * lead[j, i]


@inlined
def grow_cohort(buffer, deck, duration):
    """Advance the front of the cohort, cell by cell, until it covers the deck."""
    book = deck_vector(buffer, deck)
    velocity = scene_vector(buffer, AT_SCENE, deck, 0)[S_TRANSPORT_VELOCITY]
    cells = int(buffer[N_CELLS])
    cell = cell_length(buffer, deck)
    left = duration
    while left > 0.0 and book[D_COVERED] == 0.0:
        fed = book[D_COHORT_FED] > 0.0
        target = (book[D_CELLS] + 1.0) * cell if fed else deck_length(buffer, deck)
        until = max(0.0, (target - book[D_COHORT_FRONT]) / velocity)
        step = min(left, until)
        if fed and step > 0.0:
            advance_lead(buffer, deck, step)
        if until > left:
            book[D_COHORT_FRONT] += velocity * left
        else:
            book[D_COHORT_FRONT] = target
            if fed:
                index = new_slot(buffer, deck)
                finish_cell(buffer, deck, index, cell)
                package_vector(buffer, AT_CELL, deck)[int(book[D_CELLS])] = index
                book[D_CELLS] += 1.0
            if not fed or int(book[D_CELLS]) == cells:
                book[D_COVERED] = 1.0
        left -= step
    if left > 0.0:
        stream_of_covered_deck(buffer, deck, left)


# --- one deck over one communication step -------------------------------------------------------
@kernel
def advance_deck(buffer, deck, duration):
    """Advance a deck under constant motion and feed; adds to the masses of the step."""
    book = deck_vector(buffer, deck)
    scene = scene_vector(buffer, AT_SCENE, deck, 0)
    velocity = scene[S_TRANSPORT_VELOCITY]
    rate = book[D_COHORT_FED]
    deepest = PILE_DEPTH * deck_length(buffer, deck) * scene[S_DENSITY]
    heavy = rate > 0.0 and rate >= deck_width(buffer, deck) * velocity * deepest
    left = duration
    while left > 0.0:
        if heavy and book[D_PILE_OPEN] == 0.0:
            open_pile(buffer, deck)
        piling = book[D_PILE_OPEN] > 0.0
        step = left
        if piling and velocity > 0.0:
            step = min(left, max(0.0, -book[D_PILE_REAR] / velocity))
        advance_queue(buffer, deck, step)
        if piling and velocity > 0.0 and step < left:
            book[D_PILE_OPEN], book[D_PILE_REAR] = 0.0, 0.0
        if not piling and velocity > 0.0:
            grow_cohort(buffer, deck, step)
        left -= step


# --- what lies on the deck ----------------------------------------------------------------------
@kernel
def held_by_node(buffer, deck, held):
    """Add what lies on a deck to `held[node]`, kg."""
    book = deck_vector(buffer, deck)
    width = deck_width(buffer, deck)
    length = package_vector(buffer, AT_LENGTH, deck)
    used = package_vector(buffer, AT_LAYERS_USED, deck)
    queue, cell = package_vector(buffer, AT_QUEUE, deck), package_vector(buffer, AT_CELL, deck)
    packages = int(book[D_PACKAGES])
    for place in range(packages + int(book[D_CELLS])):
        index = int(queue[place]) if place < packages else int(cell[place - packages])
        area = width * length[index]
        load = column(buffer, AT_LOAD, slot(buffer, deck, index))
        for j in range(int(used[index])):
            for i in range(held.size):
                held[i] += area * load[j, i]
    if book[D_COVERED] == 0.0 and book[D_COHORT_FED] > 0.0:
        partial = column(buffer, AT_PARTIAL, deck)
        for j in range(int(book[D_PARTIAL_LAYERS])):
            for i in range(held.size):
                held[i] += width * partial[j, i]


@kernel
def package_load(buffer, deck, place):
    """Areal mass of a package of the queue, kg/m2."""
    index = queue_slot(buffer, deck, place)
    used = int(package_vector(buffer, AT_LAYERS_USED, deck)[index])
    return bed_load(column(buffer, AT_LOAD, slot(buffer, deck, index)), used)


@kernel
def depth_at_feed(buffer, deck):
    """Depth of the bed at the feed end, m."""
    book = deck_vector(buffer, deck)
    count = int(book[D_PACKAGES])
    density = scene_vector(buffer, AT_SCENE, deck, 0)[S_DENSITY]
    if book[D_PILE_OPEN] == 0.0 and book[D_COHORT_FRONT] > 0.0:
        total = 0.0
        fed = node_vector(buffer, AT_LEAD_FEED, deck)
        for i in range(fed.size):
            total += fed[i]
        return total / density
    return package_load(buffer, deck, count - 1) / density if count > 0 else 0.0


@kernel
def depth_at_discharge(buffer, deck):
    """Depth of the bed at the discharge end, m."""
    book = deck_vector(buffer, deck)
    density = scene_vector(buffer, AT_SCENE, deck, 0)[S_DENSITY]
    if book[D_COVERED] > 0.0:
        if book[D_COHORT_FED] == 0.0:
            return 0.0
        return bed_load(column(buffer, AT_LEAD, deck), int(book[D_LEAD_LAYERS])) / density
    count = int(book[D_PACKAGES])
    front = book[D_PILE_REAR] if book[D_PILE_OPEN] > 0.0 else book[D_COHORT_FRONT]
    for place in range(count):
        front += package_vector(buffer, AT_LENGTH, deck)[queue_slot(buffer, deck, place)]
    if count == 0 or front < deck_length(buffer, deck) * (1.0 - 1e-9):
        return 0.0
    return package_load(buffer, deck, 0) / density
