"""How good a result is, from the clouds alone: measures a frame, a verdict a frame, a confidence a vertex."""
