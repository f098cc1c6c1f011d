"""What is found out from a recording, or from a film of a board, once it is there."""
