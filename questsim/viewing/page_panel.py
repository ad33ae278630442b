"""The panel of the page: buttons, choices, curves and text."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import viser
import viser.uplot

from questsim.body import MAX_HEIGHT_M, MIN_HEIGHT_M
from questsim.errors import InputError
from questsim.motion.clip import FPS
from questsim.viewing.live import ROUGHNESS, SPEEDS, Session, Settings, Snapshot, Trace
from questsim.viewing.page_scene import PageScene

_SPEED_LABELS = {f"{speed:g} x": speed for speed in SPEEDS}
_PLOT_HEIGHT = 130
NO_PHYSICS = "no physics: pushes and objects do nothing"


class PagePanel:
    """Buttons, choices and curves, shared by all viewers of a page.

    An impossible request prints one line on the page and on stderr. The simulation continues.

    Args:
        server: server of the page.
        session: the session that the panel controls.
        scene: the picture; the panel can hide parts of it.
    """

    def __init__(self, server: viser.ViserServer, session: Session, scene: PageScene) -> None:
        self._server, self._session, self._scene = server, session, scene
        self._gui = server.gui
        self._trace = Trace()
        self._fields: dict[str, Any] = {}
        self.refreshed = session.settings
        self._shown_status = ""
        self._status = self._gui.add_markdown("...")
        self._add_buttons()
        self._add_choices()
        self._error_plot = self._add_plot("link error (cm)", [("error", "#d65828")])
        self._force_plot = self._add_plot(
            "force (N): left foot blue, right orange", [("left", "#2a6fc4"), ("right", "#d65828")]
        )
        self._add_what_to_show()
        self.refresh()

    # -- building ------------------------------------------------------------------------------

    def _add_buttons(self) -> None:
        gui, session = self._gui, self._session
        actions = {
            "Pause": lambda: session.pause(True),
            "Go on": lambda: session.pause(False),
            "Step": session.step_once,
            "Restart": session.restart,
        }
        group = gui.add_button_group("Time", tuple(actions))
        self._on_click(group, lambda: actions.get(group.value, lambda: None)())
        with gui.add_folder("Push the chest"):
            force = gui.add_slider("Force (N)", 20.0, 400.0, 10.0, 100.0)
            direction = gui.add_slider(
                "Direction (°)", -180.0, 180.0, 15.0, 90.0, hint="0 is forwards, 90 to the left"
            )
            push = gui.add_button("Push", color="red", hint="At the chest, for 0.2 s")
            self._on_click(push, lambda: session.push(force.value, direction.value))

    def _add_choices(self) -> None:
        gui, session = self._gui, self._session
        settings, choices = session.settings, session.choices
        with gui.add_folder("Avatar and clip"):
            self._choice("Clip", "clip", choices.clips)
            self._choice("Agent", "agent", choices.agents)
            self._choice("Sensors", "sensors", choices.sensors)
            heights = (MIN_HEIGHT_M, MAX_HEIGHT_M)
            self._slider("User (m)", "height_m", heights, 0.01, "Stature of the user")
            self._slider(
                "Avatar (m)",
                "avatar_height_m",
                heights,
                0.01,
                "Stature of the avatar; it goes along with its user's while both are the same",
            )
            speed = gui.add_dropdown(
                "Speed", tuple(_SPEED_LABELS), initial_value=f"{settings.speed:g} x"
            )
            self._on_update(
                speed, lambda: session.change(speed=_SPEED_LABELS.get(speed.value, speed.value))
            )
        with gui.add_folder("World"):
            self._choice("Terrain", "terrain", choices.terrains)
            self._slider("Roughness", "roughness", ROUGHNESS, 0.1)
            self._choice("Object", "object", choices.objects)

    def _choice(self, label: str, setting: str, options: tuple[str, ...]) -> None:
        value = getattr(self._session.settings, setting)
        field = self._gui.add_dropdown(label, options, initial_value=value)
        self._fields[setting] = field
        self._on_update(field, lambda: self._session.change(**{setting: field.value}))

    def _slider(
        self,
        label: str,
        setting: str,
        limits: tuple[float, float],
        step: float,
        hint: str | None = None,
    ) -> None:
        value = _shown(self._session.settings, setting)
        field = self._gui.add_slider(label, *limits, step, value, hint=hint)
        self._fields[setting] = field
        self._on_update(
            field, lambda: self._session.change(**{setting: round(float(field.value), 4)})
        )

    def _add_what_to_show(self) -> None:
        with self._gui.add_folder("Show", expand_by_default=False):
            for label, attribute in (
                ("Follow", "follow"),
                ("Reference", "ghost"),
                ("Devices", "devices"),
                ("Forces", "forces"),
            ):
                box = self._gui.add_checkbox(label, True)

                def show(box: Any = box, attribute: str = attribute) -> None:
                    setattr(self._scene, attribute, bool(box.value))

                self._on_update(box, show)

    def _add_plot(self, title: str, curves: list[tuple[str, str]]) -> viser.GuiUplotHandle:
        nothing = np.array([0.0, 1.0])
        return self._gui.add_uplot(
            (nothing, *(nothing * 0.0 for _ in curves)),
            (
                viser.uplot.Series(label="s"),
                *(viser.uplot.Series(label=n, stroke=c, width=2) for n, c in curves),
            ),
            title=title,
            height=_PLOT_HEIGHT,
            scales={"x": viser.uplot.Scale(time=False, auto=True)},
            legend=viser.uplot.Legend(show=False),
            cursor=viser.uplot.Cursor(show=False),
        )

    # -- obeying ---------------------------------------------------------------------------------

    def _on_click(self, button: Any, action: Callable[[], object]) -> None:
        button.on_click(lambda _: self._obey(action))

    def _on_update(self, field: Any, action: Callable[[], object]) -> None:
        @field.on_update
        def _(event: Any) -> None:
            if event.client is not None:  # not one of our own corrections
                self._obey(action)

    def _obey(self, action: Callable[[], object]) -> None:
        try:
            action()
        except InputError as error:
            self.tell(str(error))
        self.refresh()

    def tell(self, line: str) -> None:
        """Print one line on the page and on stderr."""
        print(f"page: {line}", file=sys.stderr, flush=True)
        for client in self._server.get_clients().values():
            client.add_notification("This cannot be done", line, auto_close_seconds=8.0)

    def refresh(self) -> None:
        """Update every field to the present settings."""
        settings, choices = self._session.settings, self._session.choices
        self.refreshed = settings
        for setting, options in (("agent", choices.agents), ("sensors", choices.sensors)):
            if tuple(self._fields[setting].options) != options:
                self._fields[setting].options = options
        for setting, field in self._fields.items():
            value = _shown(settings, setting)
            if field.value != value:
                field.value = value

    # -- telling ---------------------------------------------------------------------------------

    def record(self, snapshot: Snapshot) -> None:
        """Add a snapshot to the curves."""
        self._trace.add(snapshot, FPS)

    def show(self, snapshot: Snapshot) -> None:
        """Update texts and curves to a snapshot; a few times a second is enough."""
        text = status_text(snapshot, self._session.settings)
        if text != self._shown_status:
            self._shown_status = self._status.content = text
        if len(self._trace.rows) > 1:
            time, error, left, right = self._trace.columns()
            self._error_plot.data = (time, error)
            self._force_plot.data = (time, left, right)


def _shown(settings: Settings, setting: str) -> Any:
    """The value of a setting as its field shows it."""
    return settings.avatar_m if setting == "avatar_height_m" else getattr(settings, setting)


def status_text(snapshot: Snapshot, settings: Settings) -> str:
    """Two lines of Markdown on how it goes."""
    error = f"{100.0 * snapshot.error_m:.1f} cm off"
    state = {
        "fell": f"**fell** after {snapshot.time_s:.1f} s",
        "completed": f"**{'followed' if snapshot.physics else 'shown'} to the end**",
    }.get(snapshot.outcome, error)
    if snapshot.paused:
        state += ", paused"
    notes = [snapshot.note, "" if snapshot.physics else NO_PHYSICS]
    note = ", ".join(filter(None, notes))
    note = f" ({note})" if note else ""
    return (
        f"**{settings.clip}** {snapshot.time_s:.1f} of {snapshot.duration_s:.1f} s\n\n"
        f"{settings.agent}{note}: {state}"
    )
