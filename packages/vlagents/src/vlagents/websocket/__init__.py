"""openpi's websocket, both ways: its clients ask our policies, and our client asks its servers."""

from vlagents.websocket.client import WebsocketClient
from vlagents.websocket.server import WebsocketServer

__all__ = ["WebsocketClient", "WebsocketServer"]
