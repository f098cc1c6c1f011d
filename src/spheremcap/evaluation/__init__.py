"""How good the tracker is: metrics, the thesis' experiments, and a report of both."""

from spheremcap.evaluation.metrics import Score, TruthRow
from spheremcap.evaluation.tracks import Scores, evaluate, read_tracks, read_truth, scores_table

__all__ = ["Score", "Scores", "TruthRow", "evaluate", "read_tracks", "read_truth", "scores_table"]
