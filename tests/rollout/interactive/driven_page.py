"""A page that a test drives from within the program, as a browser would."""

from __future__ import annotations

import asyncio
import json
import time
from typing import Any

import numpy as np
import viser

from rcs.rollout.interactive.browser_view import BrowserView
from rcs.spatial import xyzw_to_wxyz


def hear(view: BrowserView, page: int, *, is_seen: bool = True, keys: tuple[str, ...] = ()) -> None:
    """Have a page say what it says twenty times a second."""
    link = view._link
    assert link is not None
    if page not in link._pages:
        link.admit(page)
    beat = json.dumps({"time": 1e3 * time.monotonic(), "is_seen": is_seen, "keys": keys})
    link._hear(page, link._pages[page], beat, time.monotonic())


def server_of(view: BrowserView) -> viser.ViserServer:
    assert view._server is not None
    return view._server


def control(view: BrowserView, label: str) -> Any:
    """Return a control of the panel by its label."""
    handles = server_of(view).gui._gui_input_handle_from_uuid.values()
    (found,) = (handle for handle in handles if getattr(handle, "label", None) == label)
    return found


def give(view: BrowserView, label: str, value: Any) -> None:
    """Give a control a value as a page does, or press a button, and have the session see it."""
    handle, server = control(view, label), server_of(view)
    handle._impl.value = value
    hear(view, 7)
    event = viser.GuiEvent(client=None, client_id=7, target=handle)
    for callback in handle._impl.update_cb:
        asyncio.run_coroutine_threadsafe(callback(event), server.get_event_loop()).result(10)
    view.update()


def words(view: BrowserView) -> str:
    """Return the text at the top of the panel as it is now."""
    panel = view._panel
    assert panel is not None
    panel._next_text = 0.0
    panel.show()
    return panel._status.content


def drag(view: BrowserView, robot: str, pose: np.ndarray) -> None:
    """Drag the target of a robot to a pose in the scene as a page does."""
    server = server_of(view)
    gizmo = server.scene.get_handle_by_name(f"/targets/{robot}")
    assert isinstance(gizmo, viser.TransformControlsHandle)
    gizmo._impl.position, gizmo._impl.wxyz = pose[:3].copy(), xyzw_to_wxyz(pose[3:])
    hear(view, 7)
    event = viser.TransformControlsEvent(client=None, client_id=7, target=gizmo, phase="update")
    for callback in gizmo._impl_aux.update_cb:
        asyncio.run_coroutine_threadsafe(callback(event), server.get_event_loop()).result(10)
    view.update()


def update(view: BrowserView, steps: int = 1, *, keys: tuple[str, ...] = ()) -> None:
    """Have the session go on while the page is seen, with keys that are held on it."""
    for _ in range(steps):
        hear(view, 7, keys=keys)
        time.sleep(0.005)  # for the thread that reads the keys
        view.update()
