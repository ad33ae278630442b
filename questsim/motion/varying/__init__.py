"""What ``questsim.motion.variation`` is made of: figures, ingredients, and what people can do."""
