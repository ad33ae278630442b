"""``questsim sweep``: the same training with several seeds and values of its preset."""
