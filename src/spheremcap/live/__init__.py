"""What a viewer sees over a WebSocket: a recording that is played, or tracking while it goes on. Extra `live`."""
