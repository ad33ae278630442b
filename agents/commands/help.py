"""The first pages of help of ``train.py`` and ``evaluate.py``."""

from __future__ import annotations

from questsim.short_help import ShortHelp

_MOTIONS = (
    "What to follow: synthetic (embedded motions, no download), a file or folder of your own, or a "
    "data set such as bandai-namco-2:test (questsim motions fetch downloads it)."
)

TRAIN_HELP = ShortHelp(
    about="Train a policy that moves the simulated avatar by joint torques, so that it follows a "
    "user's headset and controllers. First a teacher learns, which sees the whole motion, then the "
    "policy itself (the student), which sees only the devices. docs/tutorial.md goes through it.",
    examples=(
        ("--preset smoke --out runs/try --minutes 3", "a first try: begins to learn to stand"),
        ("--preset cpu --out runs/mine --minutes 30", "a training on two cores"),
        ("--preset cpu --out runs/mine --minutes 60 --resume", "continues it for 30 minutes more"),
    ),
    used=(
        ("--out FOLDER", "Where policies, curves and the record of the training go (required)."),
        ("--motions WHAT", _MOTIONS.replace(":test", ":train") + " Default: synthetic."),
        ("--preset NAME", "Sizes and settings: smoke (a test of minutes), cpu (two cores; the "
         "default) or paper (as published; needs many cores)."),
        ("--minutes N", "Time for the whole training, with the parts before a --resume."),
        ("--resume", "Continue the training in --out."),
    ),
    groups=(
        ("More or other motions", "heights mirrored vary redraw validation hold-out"),
        ("What the policy observes", "sensors future-frames observe-proportions"),
        ("The avatar's body", "body own-proportions proportions"),
        ("Ground, objects, pushes, device errors", "env objects pushes randomisation.*"),
        ("Where episodes begin", "starts.* start-estimates"),
        ("One stage alone; begin with other policies", "stage start teacher specialists estimates"),
        ("More processes or machines", "envs threads workers ray gradients"),
        ("Else", "steps seed log set"),
        ("A system without physics instead of a policy (own options)", "agent"),
    ),
)  # fmt: skip

EVALUATE_HELP = ShortHelp(
    about="Let a policy follow motions, from their first frame to the end or a fall, and print how "
    "well it did. docs/metrics.md explains the figures.",
    examples=(
        ("--agent runs/mine", "scores your training on the embedded motions"),
        ("--agent runs/mine --out scores --video", "also writes tables, plots and a film"),
        ("--agent questsim --motions walk.bvh", "how a shipped policy follows your own file"),
    ),
    used=(
        ("--agent NAME", "A training's folder, or the name of a shipped policy (questsim agents "
         "lists them). Default: questsim."),
        ("--motions WHAT", _MOTIONS + " Default: synthetic."),
        ("--out FOLDER", "Write the figures (metrics.json, clips.csv) and plots there."),
        ("--video", "Also film the avatar beside its user, into --out."),
        ("--max-clips N", "Follow only so many clips, of all kinds of motion."),
    ),
    groups=(
        ("Another avatar or user", "body height own-proportions unscaled"),
        ("Another world", "env terrain objects"),
        ("Device errors, first state, help against falls", "noise begin assist"),
        ("Repetitions", "seed seeds"),
        ("More files", "video-clips save-motion"),
        ("More processes or machines", "threads workers ray"),
        ("Devices of a system without physics", "sensors"),
        ("Other jobs, each with its own --help", "compare worlds scorecard by-group"),
    ),
)  # fmt: skip
