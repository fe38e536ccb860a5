"""Study of the plate: particle simulations of batches and decks, and one calibration for them."""
