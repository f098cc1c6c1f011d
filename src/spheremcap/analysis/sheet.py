"""A board to print: an SVG in true millimetres."""

import cv2
import numpy as np

from spheremcap.analysis.board import Board

_BITS_OF_BORDER = 1


def sheet_svg(board: Board) -> str:
    """The board with a white margin of one square, and what it is written below; 1 unit is 1 mm."""
    square = board.square_m * 1e3
    rects = [(x, y, square) for x, y in _black_squares(board)]
    if board.dictionary:
        rects += _black_bits(board)
    wide, high = (board.columns + 2) * square, (board.rows + 2) * square
    drawn = "".join(
        f'<rect x="{x + square:.6g}" y="{y + square:.6g}" width="{side:.6g}" height="{side:.6g}"/>\n'
        for x, y, side in rects
    )
    said = f"{board}: print at 100 %, then measure: {board.columns} squares are {board.columns * square:g} mm wide"
    size = f'width="{wide:g}mm" height="{high:g}mm" viewBox="0 0 {wide:g} {high:g}"'
    style = f'font-family="sans-serif" font-size="{square / 6:g}"'
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" {size}>'
        f'\n<rect width="{wide:g}" height="{high:g}" fill="white"/>\n<g shape-rendering="crispEdges">\n{drawn}</g>\n'
        f'<text x="{square:g}" y="{high - square / 3:g}" {style}>{said}</text>'
        "\n</svg>\n"
    )


def _black_squares(board: Board) -> list[tuple[float, float]]:
    """The upper left corners (mm) of the squares that are black; the first one is."""
    side = board.square_m * 1e3
    return [(c * side, r * side) for r in range(board.rows) for c in range(board.columns) if (c + r) % 2 == 0]


def _black_bits(board: Board) -> list[tuple[float, float, float]]:
    """Left, top and side (mm) of each black bit of the markers, their frames among them."""
    across = board.markers.markerSize + 2 * _BITS_OF_BORDER
    side = board.marker_m * 1e3 / across
    bits = []
    for number, corners_m in zip(np.ravel(board.charuco.getIds()), board.charuco.getObjPoints(), strict=True):
        left, top = np.asarray(corners_m)[:, :2].min(axis=0) * 1e3
        picture = cv2.aruco.generateImageMarker(board.markers, int(number), across, borderBits=_BITS_OF_BORDER)
        bits += [(left + c * side, top + r * side, side) for r, c in np.argwhere(np.asarray(picture) == 0).tolist()]
    return bits
