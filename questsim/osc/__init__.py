"""OSC out and in: VMC performers and marionettes, and VRChat's trackers."""
