"""AvatarPoser: headset and controllers to a full pose by a transformer over a window."""
