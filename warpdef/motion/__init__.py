"""The estimated motion put to use: on other geometry, and at times between the frames."""
