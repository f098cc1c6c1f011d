"""The main job from end to end: render a racing session with exact truth, track it, score it, say how to look at it.

usage: python examples/demo.py [FOLDER] [FRAMES]      (./run demo calls it)
"""

import subprocess
import sys
from pathlib import Path

from spheremcap.evaluation.tracks import evaluate, scores_table
from spheremcap.io.layout import layout_path


def command(*words: str) -> None:
    """Run spheremcap as a user would, and show what was run."""
    print("$ spheremcap " + " ".join(words), flush=True)
    subprocess.run([sys.executable, "-m", "spheremcap", *words], check=True)


def main() -> None:
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "demo")
    frames = sys.argv[2] if len(sys.argv) > 2 else "480"
    session, recording = folder / "session.mp4", folder / "session.mcap"
    command("synth", "racing", "-o", str(folder), "--frames", frames, "--overwrite")
    command(
        "track", str(session), "-o", str(recording), "--settings", str(folder / "settings.toml"),
        "--seeds", str(folder / "seeds.toml"), "--overwrite",
    )  # fmt: skip
    command("info", str(recording))
    command("export", str(recording), "-o", str(folder / "tracks.csv"), "--overwrite")
    layout = layout_path(recording)
    print("\nAgainst the exact truth of the rendering:")
    print(scores_table(evaluate(recording, folder / "truth.csv")))
    print(f"\nTo look at it: open {recording} in Foxglove (or Lichtblick), then import the layout {layout}.")


if __name__ == "__main__":
    main()
