"""The fit: the problem laid out on a device, objective, optimiser and vertex stage, and the threads that run them."""
