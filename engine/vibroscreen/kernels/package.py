"""One slice of the bed in time: sub-models give rates, one place here moves mass (MODEL.md,
"A package in time").

A column holds areal masses load[layer, node] in kg/m2; row 0 lies on the screen. The basic step is
implicit in each class, with rates frozen at its start: passage and percolation form one matrix per
class whose columns sum to one, so masses stay positive and nothing is lost at any step length.
Then the layers settle: what is missing below is refilled from above. Extrapolation over 1, 2, 3
and more basic steps raises the order; the error estimate sets step and order.
"""

from __future__ import annotations

from math import ceil

from vibroscreen.kernels.jit import kernel, view2
from vibroscreen.kernels.layout import (
    AT_COLUMN_FLUX,
    AT_COLUMN_TIME,
    AT_COUNTER,
    AT_NODE_WORK,
    AT_PARAMETER,
    AT_PERCOLATION,
    AT_SCRATCH,
    AT_SIZE,
    AT_SOURCE,
    AT_TRIAL,
    AT_UPWARD,
    C_COLUMN_FORCED,
    C_COLUMN_REJECTED,
    C_COLUMN_STEPS,
    C_SUB_STEPS,
    COUNTER,
    D_CAPACITY_ALARM,
    D_ORDER,
    D_ROWS,
    D_STEP,
    LAYERED,
    MAX_ORDER,
    N_LAYERS,
    N_NODES,
    PARAMETER,
    PASSAGE_ADDRESS,
    PASSAGE_LAW,
    S_BED_LOAD,
    S_CONTACT_LOAD,
    S_COVER,
    S_DENSITY,
    S_HORIZON,
    S_LAYER_FULL,
    S_LAYER_LOAD,
    S_PASSAGE_VELOCITY,
    SEGREGATION_ADDRESS,
    SEGREGATION_MODEL,
    TOLERANCE,
    column,
    node_vector,
    vector,
)
from vibroscreen.kernels.passage import passage_probability
from vibroscreen.kernels.segregation import layer_mass, segregate

# A layer is opened only for more than this part of a full one: round-off makes no layers.
SLIVER = 1e-9
# A top layer below this part of a full one is no reason to cut a step.
THIN = 1e-3
# A part of `tolerance` that a step may always use, however short it is.
LEAST_SHARE = 0.02
# Steps below this part of the horizon are taken whatever the estimate says (counted).
SHORTEST = 1e-10


@kernel
def trial_flux(buffer, k):
    """Rows passed and its time integral of trial k."""
    nodes = int(buffer[N_NODES])
    rows = 2 * int(buffer[N_LAYERS]) + 2
    return view2(buffer, int(buffer[AT_TRIAL]) + k * rows * nodes, 2, nodes)


@kernel
def trial_load(buffer, k):
    """Loads of trial k."""
    nodes = int(buffer[N_NODES])
    layers = int(buffer[N_LAYERS])
    start = int(buffer[AT_TRIAL]) + (k * (2 * layers + 2) + 2) * nodes
    return view2(buffer, start, layers, nodes)


@kernel
def trial_time(buffer, k):
    """Time integrals of the loads of trial k."""
    nodes = int(buffer[N_NODES])
    layers = int(buffer[N_LAYERS])
    start = int(buffer[AT_TRIAL]) + (k * (2 * layers + 2) + 2 + layers) * nodes
    return view2(buffer, start, layers, nodes)


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
    scene[S_BED_LOAD] = mass
    scene[S_LAYER_FULL] = scene[S_LAYER_LOAD]
    above = mass - scene[S_CONTACT_LOAD]
    if buffer[LAYERED] == 0.0 or above <= SLIVER * scene[S_LAYER_LOAD]:
        return 1
    most = int(buffer[N_LAYERS]) - 1
    if above > most * scene[S_LAYER_LOAD] * (1.0 + SLIVER):
        scene[S_LAYER_FULL] = above / most
        return 1 + most
    return 1 + min(most, int(ceil(above / scene[S_LAYER_LOAD] - SLIVER)))


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
    old = column(buffer, AT_SCRATCH, 0)
    for j in range(layers):
        for i in range(nodes):
            old[j, i] = load[j, i]
    source = 0
    whole = layer_mass(old, 0)
    left = 1.0  # what remains of the layer `source`, as a part of it
    for j in range(wanted):
        need = scene[S_CONTACT_LOAD] if j == 0 else scene[S_LAYER_FULL]
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


@kernel
def passage_rates(buffer, scene, load, layers, rate):
    """Passage of each class as a rate on what row 0 holds of it, 1/s; fills the percolation too.

    rho_b u P_i F_0i cover with F_0i = contact_i load_0i, cover = min(1, sigma_0/sigma_c).
    """
    parameter = vector(buffer, AT_PARAMETER, len(PARAMETER), 0)
    size = node_vector(buffer, AT_SIZE, 0)
    contact = node_vector(buffer, AT_NODE_WORK, 1)
    fraction = node_vector(buffer, AT_NODE_WORK, 2)
    segregate(
        int(parameter[SEGREGATION_MODEL]),
        int(buffer[SEGREGATION_ADDRESS]),
        size,
        load,
        layers,
        scene,
        contact,
        column(buffer, AT_PERCOLATION, 0),
    )
    for i in range(size.size):
        fraction[i] = contact[i] * load[0, i]
    scene[S_COVER] = min(1.0, layer_mass(load, 0) / scene[S_CONTACT_LOAD])
    law = int(parameter[PASSAGE_LAW])
    passage_probability(law, int(buffer[PASSAGE_ADDRESS]), size, fraction, scene, rate)
    strength = scene[S_DENSITY] * scene[S_PASSAGE_VELOCITY] * scene[S_COVER]
    for i in range(size.size):
        rate[i] = max(0.0, rate[i]) * strength * contact[i]


@kernel
def upward_rates(load, down, layers, up):
    """What each layer sends up, 1/s on its mass: as much as percolates down into it."""
    for j in range(layers - 1):
        exchanged = 0.0
        for i in range(load.shape[1]):
            exchanged += down[j + 1, i] * load[j + 1, i]
        mass = layer_mass(load, j)
        up[j] = exchanged / mass if mass > 0.0 else 0.0


@kernel
def implicit_step(load, rate, down, up, pivot, stay, layers, h):
    """Solve (1 + h T_i) x = load for every class in place, T_i tridiagonal over the layers.

    The elimination is written without a subtraction (`stay` is the part of a pivot that does not
    lead upwards), so masses stay positive and sum up to round-off for any h.
    """
    nodes = load.shape[1]
    for i in range(nodes):
        stay[i] = 1.0 + h * rate[i]
    for j in range(layers - 1):
        upward = h * up[j]
        for i in range(nodes):
            pivot[j, i] = 1.0 / (stay[i] + upward)
            stay[i] = 1.0 + h * down[j + 1, i] * (stay[i] * pivot[j, i])
            load[j + 1, i] += upward * pivot[j, i] * load[j, i]
    top = layers - 1
    for i in range(nodes):
        load[top, i] /= stay[i]
    for j in range(top - 1, -1, -1):
        for i in range(nodes):
            load[j, i] = (load[j, i] + h * down[j + 1, i] * load[j + 1, i]) * pivot[j, i]


@kernel
def basic_step(buffer, scene, k, layers, h):
    """One step of first order on trial k: passage and percolation, then landing and settling.

    Returns the number of layers after it.
    """
    load = trial_load(buffer, k)
    flux = trial_flux(buffer, k)
    time = trial_time(buffer, k)
    rate = node_vector(buffer, AT_NODE_WORK, 0)
    stay = node_vector(buffer, AT_NODE_WORK, 3)
    source = node_vector(buffer, AT_SOURCE, 0)
    down = column(buffer, AT_PERCOLATION, 0)
    up = vector(buffer, AT_UPWARD, int(buffer[N_LAYERS]), 0)
    nodes = source.size
    passage_rates(buffer, scene, load, layers, rate)
    upward_rates(load, down, layers, up)
    implicit_step(load, rate, down, up, column(buffer, AT_SCRATCH, 0), stay, layers, h)
    for i in range(nodes):
        flux[0, i] += h * rate[i] * load[0, i]
        load[layers - 1, i] += h * source[i]
    layers = restack(buffer, scene, load, layers)
    for i in range(nodes):
        flux[1, i] += h * flux[0, i]
    for j in range(layers):
        for i in range(nodes):
            time[j, i] += h * load[j, i]
    return layers


@kernel
def run_trial(buffer, scene, load, k, layers, rows, h):
    """k + 1 basic steps over h from `load` into trial k, which uses at most `rows` layers."""
    flux = trial_flux(buffer, k)
    trial = trial_load(buffer, k)
    time = trial_time(buffer, k)
    nodes = load.shape[1]
    for i in range(nodes):
        flux[0, i] = 0.0
        flux[1, i] = 0.0
    for j in range(rows):
        for i in range(nodes):
            trial[j, i] = load[j, i]
            time[j, i] = 0.0
    layers_for(buffer, scene, bed_load(load, layers))
    for _ in range(k + 1):
        layers = basic_step(buffer, scene, k, layers, h / (k + 1))


@kernel
def rows_in_use(buffer, scene, load, layers, h):
    """Layers that a step of h may need: what lands opens new ones, nothing else does."""
    landing = 0.0
    source = node_vector(buffer, AT_SOURCE, 0)
    for i in range(source.size):
        landing += source[i]
    if landing == 0.0:
        return layers
    more = layers_for(buffer, scene, bed_load(load, layers) + h * landing) + 1
    return max(layers, min(more, load.shape[0]))


@kernel
def extrapolate(buffer, k, rows):
    """Aitken-Neville on the trials 0..k; the best value lies in trial 0, the next in trial 1.

    Trial k keeps its own first-order value. `rows` is the highest number of layers in use.
    """
    width = int(buffer[N_NODES])
    layers = int(buffer[N_LAYERS])
    size = (2 * layers + 2) * width
    for level in range(1, k + 1):
        factor = 1.0 / ((k + 1.0) / (k + 1.0 - level) - 1.0)
        better = vector(buffer, AT_TRIAL, size, k - level + 1)
        coarse = vector(buffer, AT_TRIAL, size, k - level)
        for start, stop in ((0, 2 + rows), (2 + layers, 2 + layers + rows)):
            for i in range(start * width, stop * width):
                coarse[i] = better[i] + factor * (better[i] - coarse[i])


@kernel
def step_error(buffer, reference, rows):
    """Largest difference of the two best extrapolations as a part of what was fed of a class."""
    flux, coarse_flux = trial_flux(buffer, 0), trial_flux(buffer, 1)
    load, coarse_load = trial_load(buffer, 0), trial_load(buffer, 1)
    worst = 0.0
    for i in range(reference.size):
        if reference[i] > 0.0:
            moved = 0.0
            for j in range(rows):
                moved += abs(load[j, i] - coarse_load[j, i])
            error = abs(flux[0, i] - coarse_flux[0, i]) + 0.5 * moved
            worst = max(worst, error / reference[i])
    return worst


@kernel
def carry_debts(flux, load, rows):
    """Pay what extrapolation drew below zero from the same class next to it; sums stay.

    From the top layer down to what passed, and back up if that became a debt: a class as a whole
    is never below zero, so nothing is. Such debts are of the size of the step's error.
    """
    for i in range(flux.size):
        debt = 0.0
        for j in range(rows - 1, -1, -1):
            debt += load[j, i]
            load[j, i] = max(0.0, debt)
            debt = min(0.0, debt)
        flux[i] += debt
        debt = min(0.0, flux[i])
        flux[i] = max(0.0, flux[i])
        for j in range(rows):
            debt += load[j, i]
            load[j, i] = max(0.0, debt)
            debt = min(0.0, debt)


@kernel
def accept(buffer, scene, load, rows, h):
    """Take trial 0 as the state after h and add its sums; returns the layers."""
    best = trial_load(buffer, 0)
    flux = trial_flux(buffer, 0)
    time = trial_time(buffer, 0)
    carry_debts(flux[0], best, rows)
    carry_debts(flux[1], time, rows)
    total_time = column(buffer, AT_COLUMN_TIME, 0)
    passed = node_vector(buffer, AT_COLUMN_FLUX, 0)
    passed_time = node_vector(buffer, AT_COLUMN_FLUX, 1)
    for i in range(passed.size):
        passed_time[i] += h * passed[i] + flux[1, i]
        passed[i] += flux[0, i]
    for j in range(rows):
        for i in range(passed.size):
            load[j, i] = best[j, i]
            total_time[j, i] += time[j, i]
    return restack(buffer, scene, load, rows)


@kernel
def try_step(buffer, scene, load, reference, layers, h, book):
    """Raise the order until the error of a step of h meets the tolerance.

    Returns the number of trials, negative if it does not meet it; the next step and order go to
    `book`.
    """
    parameter = vector(buffer, AT_PARAMETER, len(PARAMETER), 0)
    horizon = scene[S_HORIZON]
    share = max(LEAST_SHARE, h / horizon) if horizon > 0.0 else LEAST_SHARE
    allowed = parameter[TOLERANCE] * share
    counter = vector(buffer, AT_COUNTER, len(COUNTER), 0)
    target = int(book[D_ORDER])
    rows = rows_in_use(buffer, scene, load, layers, h)
    book[D_ROWS] = rows
    last, last_cost, last_fit = 1.0, 1e300, h
    used = 0
    for k in range(min(target + 1, MAX_ORDER)):
        run_trial(buffer, scene, load, k, layers, rows, h)
        counter[C_SUB_STEPS] += k + 1
        extrapolate(buffer, k, rows)
        used = k + 1
        if k == 0:
            continue
        error = max(step_error(buffer, reference, rows) / allowed, 1e-30)
        fit = h * min(6.0, max(0.1, 0.9 * (0.5 / error) ** (1.0 / used)))
        cost = trial_cost(used) / fit
        if error <= 1.0:
            book[D_ORDER], book[D_STEP] = used, fit
            if last_cost < 0.9 * cost:
                book[D_ORDER], book[D_STEP] = used - 1, last_fit
            elif used < MAX_ORDER - 1:
                book[D_ORDER], book[D_STEP] = used + 1, trial_cost(used + 1) / cost
            return used
        gain = min(1.0, error / last) if k > 1 else 0.1
        expected = error * gain ** (target - used)
        book[D_STEP] = h * min(0.6, max(0.1, 0.9 * (0.5 / expected) ** (1.0 / target)))
        if k > 1 and expected * gain > 4.0:
            break
        last, last_cost, last_fit = error, cost, fit
    return -used


@kernel
def trial_cost(order):
    """Basic steps of an extrapolated step of this order, and one for its overhead."""
    return 1.0 + 0.5 * order * (order + 1)


@kernel
def first_step(buffer, scene, load, duration):
    """A first step: the time in which the screen could take the contact layer once, s."""
    pace = scene[S_PASSAGE_VELOCITY] * scene[S_DENSITY] / scene[S_CONTACT_LOAD]
    return min(duration, 0.25 / pace) if pace > 0.0 else duration


@kernel
def passing_rate(buffer, scene, load, layers):
    """What passes now in all, kg/(m2 s)."""
    rate = node_vector(buffer, AT_NODE_WORK, 0)
    passage_rates(buffer, scene, load, layers, rate)
    total = 0.0
    for i in range(rate.size):
        total += rate[i] * load[0, i]
    return total


@kernel
def mass_to_kink(scene, load, layers):
    """Mass that passes until the top layer is gone, kg/m2 (0: no such moment ahead).

    Rates have a kink there. A top layer thinner than THIN of a full one does not count: what it
    could change is below what the extrapolation resolves.
    """
    above = bed_load(load, layers) - scene[S_CONTACT_LOAD]
    if layers == 1:
        return max(0.0, above)
    top = layer_mass(load, layers - 1)
    if top > THIN * scene[S_LAYER_FULL] or layers == 2:
        return top
    return top + layer_mass(load, layers - 2)


@kernel
def time_to_pass(mass, rate, slope):
    """Time in which `mass` passes at a rate that changes linearly, s; -1 if it never does."""
    root = rate * rate + 2.0 * slope * mass
    if rate <= 0.0 or root <= 0.0:
        return -1.0
    return 2.0 * mass / (rate + root**0.5)


@kernel
def clear_sums(buffer):
    """Zero the sums of `integrate`."""
    for row in range(2):
        flux = node_vector(buffer, AT_COLUMN_FLUX, row)
        for i in range(flux.size):
            flux[i] = 0.0
    total_time = column(buffer, AT_COLUMN_TIME, 0)
    for j in range(total_time.shape[0]):
        for i in range(total_time.shape[1]):
            total_time[j, i] = 0.0


@kernel
def integrate(buffer, scene, book, load, reference, layers, duration):
    """Let a column go through `duration` s; returns the number of layers after it.

    `load` is advanced in place. The fields column_flux (what passed, kg/m2, and its time integral)
    and column_time (time integral of the loads, kg s/m2) hold the sums over the duration.
    `reference` is what was fed of each node, kg/m2: errors are a part of it. Steps are drawn to
    the moments at which a layer runs out.
    """
    counter = vector(buffer, AT_COUNTER, len(COUNTER), 0)
    clear_sums(buffer)
    if book[D_STEP] <= 0.0:
        book[D_STEP], book[D_ORDER] = first_step(buffer, scene, load, duration), 3
    shortest = SHORTEST * max(duration, scene[S_HORIZON])
    left = duration
    rate, slope = -1.0, 0.0
    h = 0.0
    used = 1
    while left > 0.0:
        planned, order = book[D_STEP], book[D_ORDER]
        if used > 0:
            before = rate
            rate = passing_rate(buffer, scene, load, layers)
            slope = (rate - before) / h if h > 0.0 and before > 0.0 else 0.0
        h = left if planned > 0.99 * left else min(planned, 0.5 * left)
        kink = time_to_pass(mass_to_kink(scene, load, layers), rate, slope)
        if shortest < kink < h:
            h = kink
        used = try_step(buffer, scene, load, reference, layers, h, book)
        if used < 0 and h > shortest:
            counter[C_COLUMN_REJECTED] += 1
            continue
        if used < 0:
            counter[C_COLUMN_FORCED] += 1
            used = -used
            book[D_STEP] = 4.0 * h
        elif h < planned:
            book[D_STEP], book[D_ORDER] = max(planned, book[D_STEP]), max(order, book[D_ORDER])
        counter[C_COLUMN_STEPS] += 1
        rows = int(book[D_ROWS])
        layers = accept(buffer, scene, load, rows, h)
        if scene[S_LAYER_FULL] > scene[S_LAYER_LOAD]:
            book[D_CAPACITY_ALARM] = 1.0
        left = 0.0 if h == left else left - h
    return layers
