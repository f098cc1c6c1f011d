"""Many sessions: what there is (`manifest`, `finding`), each in a process of its own (`session`, `worker`, `run`), and
what came of all of them (`outcome`, `requests`, `tables`, `page`)."""
