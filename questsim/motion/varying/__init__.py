"""Parts of ``questsim.motion.variation``: figures, ingredients and feasibility checks."""
