"""Packages ride along the deck: panels, discharge, what passes on the way."""

from __future__ import annotations

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels import state
from vibroscreen.kernels.bed import falls, package, travel
from vibroscreen.kernels.numerics import integrate, layers


@kernel
def integrate_package(buffer, deck, index, duration):
    """Advance the column of a package; its step and order are remembered with it."""
    book = state.book(buffer, deck)
    whole = state.slot(buffer, deck, index)
    pace = state.vector(buffer, state.AT.pace, 4, whole)
    lead_pace = (book.step, book.order, book.pace, book.wide)
    package.use_pace(book, pace)
    used = state.package_vector(buffer, state.AT.layers_used, deck)
    used[index] = integrate.integrate(
        buffer,
        package.package_scene(buffer, deck, index),
        book,
        state.column(buffer, state.AT.load, whole),
        state.node_vector(buffer, state.AT.reference, whole),
        int(used[index]),
        duration,
    )
    package.keep_pace(book, pace)
    package.use_pace(book, lead_pace)
    state.counters(buffer).packages_integrated += 1.0


@kernel
def pass_through(buffer, deck, row, scale, scale_time):
    """Book what passed, scale x passed + scale_time x its integral, as undersize of the deck."""
    undersize = state.node_vector(buffer, state.AT.step_mass, deck)
    passed = state.node_vector(buffer, state.AT.column_flux, 0)
    passed_time = state.node_vector(buffer, state.AT.column_flux, 1)
    fallen = falls.fall_vector(buffer, deck, row)
    record = deck + 1 < state.extent(buffer).decks
    for i in range(passed.size):
        mass = scale * passed[i] + scale_time * passed_time[i]
        undersize[i] += mass
        if record:
            fallen[i] += mass


@kernel
def land_on(buffer, row, area, time):
    """Spread what lands on a package over an area [m2] and a time [s], kg/(m2 s)."""
    if area * time <= 0.0:
        return
    source = state.node_vector(buffer, state.AT.source, 0)
    landing = state.node_vector(buffer, state.AT.landing, row)
    for i in range(source.size):
        source[i] = landing[i] / (area * time)
        if source[i] != 0.0:
            state.extent(buffer).source_terms = 1.0


@kernel
def refer_to_landing(buffer, deck, index, row):
    """Add what lands on a package to what was fed to it, the measure of its errors, kg/m2."""
    reference = state.node_vector(buffer, state.AT.reference, state.slot(buffer, deck, index))
    landing = state.node_vector(buffer, state.AT.landing, row)
    area = (
        travel.deck_width(buffer, deck) * state.package_vector(buffer, state.AT.length, deck)[index]
    )
    for i in range(reference.size):
        if landing[i] > 0.0:
            reference[i] += landing[i] / area


@kernel
def ride(buffer, deck, index, row, duration):
    """Let a package lie on the deck as a whole for `duration` s; what passes is undersize."""
    if duration > 0.0:
        integrate_package(buffer, deck, index, duration)
        area = (
            travel.deck_width(buffer, deck)
            * state.package_vector(buffer, state.AT.length, deck)[index]
        )
        pass_through(buffer, deck, row, area, 0.0)


@kernel
def discharge(buffer, deck, index, row, duration, rest):
    """Shorten a package to the length `rest` over the deck's end, evenly in `duration` s.

    With length l(t): undersize W integral of l dp, oversize W integral of load (-dl); both follow
    exactly from the time integrals of what passed and of the loads.
    """
    length = state.package_vector(buffer, state.AT.length, deck)
    integrate_package(buffer, deck, index, duration)
    width = travel.deck_width(buffer, deck)
    shortening = (length[index] - rest) / duration
    pass_through(buffer, deck, row, width * rest, width * shortening)
    oversize = state.node_vector(buffer, state.AT.step_mass, state.extent(buffer).decks + deck)
    time = state.column(buffer, state.AT.column_time, 0)
    for j in range(int(state.book(buffer, deck).rows)):
        for i in range(oversize.size):
            oversize[i] += width * shortening * time[j, i]
    length[index] = rest


@kernel
def idle(buffer, deck, index, row):
    """Whether nothing can happen inside a package: empty and nothing lands, or all is at rest."""
    if state.switches(buffer).idle_packages == 0.0:
        return False
    if deck > 0:
        landing = state.node_vector(buffer, state.AT.landing, row)
        for i in range(landing.size):
            if landing[i] != 0.0:
                return False
    scene = package.package_scene(buffer, deck, index)
    if scene.passage_velocity + scene.segregation_velocity + scene.mixing == 0.0:
        return not travel.conveys(buffer, deck)
    used = int(state.package_vector(buffer, state.AT.layers_used, deck)[index])
    return (
        layers.bed_load(state.column(buffer, state.AT.load, state.slot(buffer, deck, index)), used)
        == 0.0
    )


@kernel
def shed(buffer, deck, index):
    """Let what is left of a package fall over the deck's end at once."""
    load = state.column(buffer, state.AT.load, state.slot(buffer, deck, index))
    length = state.package_vector(buffer, state.AT.length, deck)
    area = travel.deck_width(buffer, deck) * length[index]
    oversize = state.node_vector(buffer, state.AT.step_mass, state.extent(buffer).decks + deck)
    for j in range(int(state.package_vector(buffer, state.AT.layers_used, deck)[index])):
        for i in range(oversize.size):
            oversize[i] += area * load[j, i]
    length[index] = 0.0


@kernel
def cross(buffer, deck, index):
    """Move a package to the next panel: its length changes with the velocity, its mass stays."""
    panel = state.package_vector(buffer, state.AT.on_panel, deck)
    before = package.package_velocity(buffer, deck, index)
    panel[index] += 1.0
    stretch = package.package_velocity(buffer, deck, index) / before
    whole = state.slot(buffer, deck, index)
    load = state.column(buffer, state.AT.load, whole)
    reference = state.node_vector(buffer, state.AT.reference, whole)
    used = state.package_vector(buffer, state.AT.layers_used, deck)
    state.package_vector(buffer, state.AT.length, deck)[index] *= stretch
    for i in range(reference.size):
        reference[i] /= stretch
        for j in range(int(used[index])):
            load[j, i] /= stretch
    used[index] = layers.restack(
        buffer, package.package_scene(buffer, deck, index), load, int(used[index])
    )


@kernel
def ride_panels(buffer, deck, index, row, middle, duration, time):
    """Let a package ride for `duration` s, over the ends of panels; `middle` is its riding time.

    What lands on it comes evenly within `time` s, of which this is a part.
    """
    left = duration
    width = travel.deck_width(buffer, deck)
    while True:
        step = left
        panel = package.panel_of(buffer, deck, index)
        crosses = False
        if panel + 1 < travel.panel_count(buffer, deck) and travel.conveys(buffer, deck):
            until = travel.panel_end_time(buffer, deck, panel) - middle
            crosses = until < left
            step = max(0.0, until) if crosses else left
        if deck > 0:
            area = width * state.package_vector(buffer, state.AT.length, deck)[index]
            land_on(buffer, row, area, time)
        ride(buffer, deck, index, row, step)
        state.extent(buffer).source_terms = 0.0
        left -= step
        middle += step
        if not crosses:
            return
        cross(buffer, deck, index)


@kernel
def advance_package(buffer, deck, index, row, rear, duration):
    """Move a package whose rear is at the riding time `rear`; returns the length that is left."""
    length = state.package_vector(buffer, state.AT.length, deck)
    whole, over = duration, 0.0  # time as a whole on the deck, then while it is discharged
    span = package.package_span(buffer, deck, index)
    rest = span
    if travel.conveys(buffer, deck):
        end = travel.residence_time(buffer, deck)
        whole = min(duration, max(0.0, end - rear - span))
        if whole < min(duration, package.MOMENT * span):
            whole = 0.0
        over = min(duration, max(0.0, end - rear)) - whole
        rest = min(rest, end - rear - duration)
        if rest < package.MOMENT * end / travel.cell_count(buffer, deck):
            rest = 0.0
        if rest >= span:
            whole, over = whole + over, 0.0
    if idle(buffer, deck, index, row):
        state.counters(buffer).packages_skipped += 1.0
        ride_over(buffer, deck, index, rear + 0.5 * span + whole)
        if rest == 0.0 and over + whole > 0.0 and travel.conveys(buffer, deck):
            shed(buffer, deck, index)
        elif rest < span:
            length[index] = rest * package.package_velocity(buffer, deck, index)
        return length[index]
    if deck > 0:
        refer_to_landing(buffer, deck, index, row)
    ride_panels(buffer, deck, index, row, rear + 0.5 * span, whole, whole + over)
    if rest < span and over > 0.0:
        rest *= package.package_velocity(buffer, deck, index)
        if deck > 0:
            area = 0.5 * travel.deck_width(buffer, deck) * (length[index] + rest)
            land_on(buffer, row, area, whole + over)
        discharge(buffer, deck, index, row, over, rest)
        state.extent(buffer).source_terms = 0.0
    elif rest == 0.0 and travel.conveys(buffer, deck):
        shed(buffer, deck, index)
    return length[index]


@kernel
def ride_over(buffer, deck, index, middle):
    """Move a package in which nothing happens on to the panel of its middle."""
    if travel.conveys(buffer, deck):
        panel = package.panel_of(buffer, deck, index)
        while panel + 1 < travel.panel_count(buffer, deck):
            if travel.panel_end_time(buffer, deck, panel) > middle:
                break
            cross(buffer, deck, index)
            panel += 1


@kernel
def queue_rear(buffer, deck):
    """Riding time of the rear end of the queue, s (its place where the deck stands still)."""
    book = state.book(buffer, deck)
    if book.pile_open > 0.0:
        return travel.riding_time(buffer, deck, book.pile_rear)
    return book.cohort_front
