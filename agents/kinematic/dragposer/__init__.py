"""DragPoser."""
