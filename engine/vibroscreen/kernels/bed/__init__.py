"""How the bed rides along the decks."""
