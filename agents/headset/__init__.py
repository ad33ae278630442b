"""``questsim live``: a person with a headset, the avatar, and the page that shows it."""
