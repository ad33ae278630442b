"""QuestSim: a physically simulated avatar driven by a headset and two controllers."""

__version__ = "0.1.0"
