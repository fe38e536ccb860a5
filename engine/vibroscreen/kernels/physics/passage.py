"""Passage out of the contact layer: the law is chosen by its number (MODEL.md, "Passage").

    law(size[node], fraction[node], scene, probability[node])

reads node sizes in m (ascending), the mass fractions F_0 in the contact layer and the scene of the
panel, and writes P_i.
"""

from vibroscreen.compiler.language import kernel, own_model
from vibroscreen.kernels import state
from vibroscreen.kernels.physics import bounce, gaudin, pelevin

call_passage = own_model("passage", "vector", "vector", state.SCENE, "vector")
GAUDIN, PELEVIN, BOUNCE = 1, 2, 3


@kernel
def passage_probability(law, address, size, fraction, scene, probability):
    """P_i of the chosen law; `address` is that of a user's own."""
    if law == GAUDIN:
        gaudin.gaudin(size, fraction, scene, probability)
    elif law == PELEVIN:
        pelevin.pelevin(size, fraction, scene, probability)
    elif law == BOUNCE:
        bounce.bounce(size, fraction, scene, probability)
    else:
        call_passage(address, size, fraction, scene, probability)
