"""Messages of plain values and arrays, over sockets, shared memory or a websocket."""
