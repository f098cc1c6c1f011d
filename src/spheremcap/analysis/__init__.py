"""From poses to what a lab publishes: the chair's frame, strokes, arms, focal length, the session's page."""
