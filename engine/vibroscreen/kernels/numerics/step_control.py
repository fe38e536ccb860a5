"""How long a step may be: scheme, length, safety (MODEL.md, "Step control")."""

from math import ceil, sqrt

from vibroscreen.compiler.elementary import raised
from vibroscreen.compiler.language import kernel
from vibroscreen.kernels import state
from vibroscreen.kernels.numerics import blocks, chain, explicit, kinks, pair, within
from vibroscreen.kernels.numerics.reconstruction import reconstructed
from vibroscreen.kernels.physics import segregation

# A step that should end where a layer runs out goes on for so much of what is expected; one that
# would end a little before that is made longer by up to the second factor.
PAST = 1.2
STRETCH = 1.35
# A step that went past such a moment is shortened to no less than this part of it at once.
LEAST_LANDING = 0.1
# A first step of the pair, as a part of the longest that is stable: at a tolerance of 1e-3, and at
# most. An error of order 6 in a step meets a tolerance with its sixth root.
FIRST_PAIR, MOST_FIRST = 0.33, 0.7
# The pair's estimate is that of order 4. Of what changes smoothly at any real rate up to the
# fastest, order 5 leaves out at most this part of it, times h times fastest rate.
HIGHER, LEAST_HIGHER = 0.39, 0.02
# Estimates may be this much above the tolerance, as what they find is mostly damped later on: the
# error of a recovery stays below it (tests/benchmarks/work_precision.py). Models that sort the bed
# have a kink at every size, where no order is left; a reconstruction has them in every layer.
MARGIN = (5.0, 7.0)
MARGIN_SORTED = (3.0, 2.0)
# The same for the steps of the chain that an error of third order in a step of the pair foretells,
# and how many times as long as that step they may be.
MARGIN_WIDE = 20.0
MOST_WIDER = 5.0
# A last step may be this part longer than planned: the estimate has that much in reserve.
SLACK = 0.12
# Parts of the step that an estimate allows.
SAFETY, SAFETY_WIDE = 0.93, 0.85


@kernel
def has_kinks(buffer):
    """Whether the rates have a kink at every size or in every layer."""
    parameter = state.parameters(buffer)
    model = parameter.segregation_model
    partly = model == segregation.PROPORTIONAL and parameter.segregation_proportion > 0.0
    return partly or model == segregation.CLASSIFIED or reconstructed(buffer)


@kernel
def first_pair(buffer, book):
    """A first step of the pair, as a part of the longest that is stable."""
    tolerance = state.parameters(buffer).solver_tolerance * book.share
    return min(MOST_FIRST, FIRST_PAIR * raised(1e3 * tolerance, 1.0 / 6.0))


@kernel
def choose_scheme(buffer, book, fastest, left):
    """The scheme that is cheapest for the steps that accuracy and stability allow, and its step.

    The cost is rates over time: six a step of the pair, as many as stages of the others. Returns
    the scheme and h [s].
    """
    most = explicit.STABLE / fastest if fastest > 0.0 else left
    pace = book.pace if book.pace > 0.0 else first_pair(buffer, book) * most
    scheme, h = explicit.PAIR, min(pace, most)
    rates = 6
    wide = book.wide
    if wide > 0.0:
        scale = 1.0 / fastest if fastest > 0.0 else left
        for stages in range(chain.CHAIN_LEAST, chain.CHAIN_MOST + 1):
            reach = min(wide, chain.CHAIN_STABLE[stages - chain.CHAIN_LEAST] * scale)
            if stages * h < rates * reach:
                scheme, h, rates = explicit.CHAIN, reach, stages
            if reach == wide:
                break
    # Steps of one length to the end.
    return scheme, left / max(1.0, ceil(left / h - SLACK))


@kernel
def step_factor(error, scheme):
    """Next step over this one, of which `error` is the estimate as a part of what is allowed.

    What is allowed grows with the step: an error of order h^p leaves the root of order p - 1. That
    of the pair, 5, is taken as 16/3, that of the chain, 3, as 16/5: square roots are cheap.
    """
    root = sqrt(sqrt(max(error, 1e-10)))
    if scheme == explicit.CHAIN:
        return SAFETY_WIDE / (root * sqrt(sqrt(root)))
    root = sqrt(root)
    return SAFETY / (root * sqrt(root))


@kernel
def longest_step(scheme, h, fastest):
    """A step that may be a little longer than h, but for stability, s."""
    if fastest == 0.0:
        return STRETCH * h
    most = explicit.STABLE if scheme == explicit.PAIR else chain.REACH
    return min(STRETCH * h, max(h, most / fastest))


@kernel
def planned_length(buffer, scene, book, step, layers, mass):
    """A first length and scheme of an explicit step; whether it ends, and passes, at a kink."""
    growth, kink = step.growth, step.kink
    scheme, h = choose_scheme(buffer, book, step.fastest, step.left)
    cut = 0.0 < kink < STRETCH * h
    passes = cut and growth < 0.0 and blocks.follows_share(buffer, layers)
    if passes:
        over = kinks.over_allowed(buffer, scene, book, layers, h, growth)
        if over > 0.0:
            cut = False
            h = min(h, (mass + over) / -growth)
    if cut:
        # A little further, where the rates go on smoothly: it ends at the kink all the same.
        past = PAST * kink if layers > 1 and growth < 0.0 else kink
        h = min(past, longest_step(scheme, h, step.fastest), step.left)
    step.length, step.scheme, step.landed = h, scheme, 1.0
    return cut, passes


@kernel
def explicit_length(buffer, scene, book, step, layers):
    """Find the length of an explicit step that meets the tolerance, its stages done.

    Into `step`: length, scheme, and the part of the step that lies before a kink.
    """
    counter = state.counters(buffer)
    full = scene.layer_full if layers > 1 else scene.contact_load
    mass = blocks.top_mass(buffer, blocks.NOW, layers)
    miss = kinks.miss_of(buffer, layers, step.growth) * full
    sorted_bed = has_kinks(buffer)
    first = book.wide == 0.0 and state.work(buffer).parts > 0
    cut, passes = planned_length(buffer, scene, book, step, layers, mass)
    landings = 0
    while True:
        h, scheme = step.length, step.scheme
        allowed = margin_of(scheme, sorted_bed) * kinks.allowance(buffer, scene, book, h)
        error = try_explicit(buffer, scene, step, layers) / allowed
        if scheme == explicit.PAIR and not sorted_bed and state.work(buffer).source_terms == 0:
            error *= max(LEAST_HIGHER, HIGHER * h * step.fastest)
        moved = abs(blocks.top_mass(buffer, blocks.STAGED, layers) - mass)
        lands = step.distance > 0.0 and moved > step.distance + miss and landings < 8
        if lands and passes:
            most = kinks.FORETOLD * kinks.OVER_MARGIN * kinks.allowance(buffer, scene, book, h)
            over = moved - mass
            lands = kinks.misplaced(buffer, scene, layers, blocks.STAGED, blocks.K7, over) > most
        if lands:
            # Past a kink: the step ends there, and is tried anew where its error came from that.
            change = step.distance if step.growth > 0.0 else -step.distance
            part = within.part_to_kink(buffer, layers, h, scheme, change)
            counter.landings += 1
            cut = True
            if error > 1.0:
                step.length *= max(part, LEAST_LANDING)
                landings += 1
                continue
            step.landed = part
        fit = h * min(5.0, max(0.2, step_factor(error, scheme)))
        if error > 1.0 and h > step.shortest:
            counter.column_steps_rejected += 1
            step.length = min(fit, 0.9 * h)
            cut = False
            continue
        if error > 1.0:
            counter.column_steps_forced += 1
        if first and scheme == explicit.PAIR:  # of a cohort: the next one begins with it
            book.first_pace = fit
        plan_next(buffer, book, step, layers, fit, allowed, sorted_bed, cut)
        return


@kernel
def try_explicit(buffer, scene, step, layers):
    h, moment = step.length, step.duration - step.left
    if step.scheme == explicit.CHAIN:
        stages = chain.chain_stages(h * step.fastest)
        return chain.chain_step(buffer, scene, layers, h, stages, moment)
    return pair.pair_step(buffer, scene, layers, h, moment)


@kernel
def margin_of(scheme, sorted_bed):
    """How far above the tolerance the estimate of a scheme may be."""
    return MARGIN_SORTED[scheme] if sorted_bed else MARGIN[scheme]


@kernel
def plan_next(buffer, book, step, layers, fit, allowed, sorted_bed, cut):
    """Keep the steps that the next ones of the pair and of the chain may have."""
    counter = state.counters(buffer)
    if step.scheme == explicit.PAIR:
        book.pace = max(fit, book.pace) if cut else fit
        margin = margin_of(explicit.PAIR, sorted_bed)
        error = explicit.third_order_error(buffer, step.length, layers)
        error = error * margin / (allowed * MARGIN_WIDE)
        book.wide = step.length * min(MOST_WIDER, SAFETY_WIDE / sqrt(max(error, 1e-10)))
        counter.pair_steps += 1
    else:
        # No step was tried that is longer than the chain is stable.
        fit = min(fit, chain.REACH / step.fastest)
        book.wide = max(fit, book.wide) if cut else fit
        counter.chain_steps += 1
