"""A person in the loop: what is shown, asked and answered about an opened session; HTTP is only in `server`."""
