"""What is done to the clouds before the method sees them: what is no part of the object is left out, and told."""
