"""Live simulations in the browser: the demo, and policies in training."""
