"""Packages ride along the deck: panels, discharge, what passes on the way."""

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels import state
from vibroscreen.kernels.bed import falls, package, travel
from vibroscreen.kernels.numerics import integrate, vectors


@kernel
def integrate_package(buffer, deck, index, duration, terms):
    """Advance the column of a package; its step and order are remembered with it."""
    book, pace = state.book(buffer, deck), state.pace(buffer, deck, index)
    lead_pace = (book.step, book.order, book.pace, book.wide)
    package.use_pace(book, pace)
    scene = package.scene_of(buffer, deck, index)
    load, reference = state.load(buffer, deck, index), state.reference(buffer, deck, index)
    used = state.layers_used(buffer, deck)
    layers = int(used[index])
    used[index] = integrate.integrate(buffer, scene, book, load, reference, layers, duration, terms)
    package.keep_pace(book, pace)
    package.use_pace(book, lead_pace)
    state.counters(buffer).packages_integrated += 1.0


@kernel
def pass_through(buffer, deck, row, scale, scale_time):
    """Book what passed, scale x passed + scale_time x its integral, as undersize of the deck."""
    undersize = falls.undersize(buffer, deck)
    passed, passed_time = state.column_flux(buffer, 0), state.column_flux(buffer, 1)
    fallen = state.fall(buffer, deck, row)
    record = deck + 1 < state.extent(buffer).decks
    for i in range(passed.size):
        mass = scale * passed[i] + scale_time * passed_time[i]
        undersize[i] += mass
        if record:
            fallen[i] += mass


@kernel
def land_on(buffer, row, area, time):
    """Spread what lands on a package over an area [m2] and a time [s]; the terms of that source."""
    source, landing, terms = state.source(buffer), state.landing(buffer, row), 0.0
    if area * time > 0.0:
        for i in range(landing.size):
            source[0, i] = landing[i] / (area * time)
            terms = 1.0 if source[0, i] != 0.0 else terms
    return terms


@kernel
def refer_to_landing(buffer, deck, index, row):
    """Add what lands on a package to what was fed to it, the measure of its errors, kg/m2."""
    reference, landing = state.reference(buffer, deck, index), state.landing(buffer, row)
    area = package.area_of(buffer, deck, index)
    for i in range(reference.size):
        if landing[i] > 0.0:
            reference[i] += landing[i] / area


@kernel
def ride(buffer, deck, index, row, duration, terms):
    """Let a package lie on the deck as a whole for `duration` s; what passes is undersize."""
    if duration > 0.0:
        integrate_package(buffer, deck, index, duration, terms)
        pass_through(buffer, deck, row, package.area_of(buffer, deck, index), 0.0)


@kernel
def discharge(buffer, deck, index, row, duration, rest, terms):
    """Shorten a package to the length `rest` over the deck's end, evenly in `duration` s.

    With length l(t): undersize W integral of l dp, oversize W integral of load (-dl); both follow
    exactly from the time integrals of what passed and of the loads.
    """
    length = state.length(buffer, deck)
    integrate_package(buffer, deck, index, duration, terms)
    width = state.width(buffer)[deck]
    shortening = (length[index] - rest) / duration
    pass_through(buffer, deck, row, width * rest, width * shortening)
    time, rows = state.column_time(buffer), state.book(buffer, deck).rows
    vectors.add_rows(falls.oversize(buffer, deck), width * shortening, time, rows)
    length[index] = rest


@kernel
def idle(buffer, deck, index, row):
    """Whether nothing can happen inside a package: empty and nothing lands, or all is at rest."""
    if state.switches(buffer).idle_packages == 0.0:
        return False
    if deck > 0:
        landing = state.landing(buffer, row)
        for i in range(landing.size):
            if landing[i] != 0.0:
                return False
    scene = package.scene_of(buffer, deck, index)
    if scene.passage_velocity + scene.segregation_velocity + scene.mixing == 0.0:
        return not travel.conveys(buffer, deck)
    return package.load_of(buffer, deck, index) == 0.0


@kernel
def shed(buffer, deck, index):
    """Let what is left of a package fall over the deck's end at once."""
    load, area = state.load(buffer, deck, index), package.area_of(buffer, deck, index)
    layers = package.layers_of(buffer, deck, index)
    vectors.add_rows(falls.oversize(buffer, deck), area, load, layers)
    state.length(buffer, deck)[index] = 0.0


@kernel
def cross(buffer, deck, index):
    """Move a package to the next panel: its length changes with the velocity, its mass stays."""
    before = package.velocity_of(buffer, deck, index)
    state.on_panel(buffer, deck)[index] += 1.0
    stretch = package.velocity_of(buffer, deck, index) / before
    state.length(buffer, deck)[index] *= stretch
    reference = state.reference(buffer, deck, index)
    load, layers = state.load(buffer, deck, index), package.layers_of(buffer, deck, index)
    vectors.divide(reference, load, layers, stretch)
    package.settle(buffer, deck, index, layers)


@kernel
def ride_panels(buffer, deck, index, row, middle, duration, time):
    """Let a package ride for `duration` s, over the ends of panels; `middle` is its riding time.

    What lands on it comes evenly within `time` s, of which this is a part.
    """
    left = duration
    while True:
        panel, area = package.panel_of(buffer, deck, index), package.area_of(buffer, deck, index)
        until = travel.time_to_next(buffer, deck, panel, middle)
        crosses, step = until < left, max(0.0, min(until, left))
        terms = land_on(buffer, row, area, time) if deck > 0 else 0.0
        ride(buffer, deck, index, row, step, terms)
        left -= step
        middle += step
        if not crosses:
            return
        cross(buffer, deck, index)


@kernel
def time_on_deck(buffer, deck, rear, span, duration):
    """How a package whose rear is at the riding time `rear` spends a step.

    Returns the time as a whole on the deck, the time while it is discharged, and the span that is
    left of it, s.
    """
    if not travel.conveys(buffer, deck):
        return duration, 0.0, span
    end = travel.residence_time(buffer, deck)
    whole = min(duration, max(0.0, end - rear - span))
    if whole < min(duration, package.MOMENT * span):
        whole = 0.0
    over = min(duration, max(0.0, end - rear)) - whole
    rest = min(span, end - rear - duration)
    if rest < package.MOMENT * end / state.extent(buffer).cells:
        rest = 0.0
    if rest >= span:
        return whole + over, 0.0, rest
    return whole, over, rest


@kernel
def advance_package(buffer, deck, index, row, rear, duration):
    """Move a package whose rear is at the riding time `rear`; returns the length that is left."""
    length, span = state.length(buffer, deck), package.span_of(buffer, deck, index)
    whole, over, rest = time_on_deck(buffer, deck, rear, span, duration)
    ends = rest == 0.0 and travel.conveys(buffer, deck)
    if idle(buffer, deck, index, row):
        state.counters(buffer).packages_skipped += 1.0
        ride_over(buffer, deck, index, rear + 0.5 * span + whole)
        if ends and over + whole > 0.0:
            shed(buffer, deck, index)
        elif rest < span:
            length[index] = rest * package.velocity_of(buffer, deck, index)
        return length[index]
    if deck > 0:
        refer_to_landing(buffer, deck, index, row)
    ride_panels(buffer, deck, index, row, rear + 0.5 * span, whole, whole + over)
    if rest < span and over > 0.0:
        rest *= package.velocity_of(buffer, deck, index)
        area = 0.5 * state.width(buffer)[deck] * (length[index] + rest)
        terms = land_on(buffer, row, area, whole + over) if deck > 0 else 0.0
        discharge(buffer, deck, index, row, over, rest, terms)
    elif ends:
        shed(buffer, deck, index)
    return length[index]


@kernel
def ride_over(buffer, deck, index, middle):
    """Move a package in which nothing happens on to the panel of its middle."""
    while travel.time_to_next(buffer, deck, package.panel_of(buffer, deck, index), middle) <= 0.0:
        cross(buffer, deck, index)


@kernel
def queue_rear(buffer, deck):
    """Riding time of the rear end of the queue, s (its place where the deck stands still)."""
    book, velocity = state.book(buffer, deck), travel.panel_velocity(buffer, deck, 0)
    if book.pile_open > 0.0:  # the rear of a pile lies before the feed end
        return book.pile_rear / velocity if velocity > 0.0 else book.pile_rear
    return book.cohort_front
