"""The face of a sign: a page as text in a frame, and as a picture of amber diodes."""

from __future__ import annotations

from io import BytesIO

from PIL import Image, ImageDraw, ImageFilter

from queuetail.signs.font import COLUMNS, HEIGHT_PX, WIDTH_PX
from queuetail.signs.multi import Page

PITCH = 10  # picture pixels from diode to diode
GAP, MARGIN = 2, 3  # diodes between characters, and around the face
LIT, DARK, PANEL, FRAME = (255, 176, 32), (44, 36, 26), (12, 12, 12), (70, 72, 74)


def rows_of(page: Page | None, lines: int, characters: int) -> tuple[str, ...]:
    """Return the face's rows of text, each as long as the face is wide."""
    rows = [""] * lines
    if page is not None:
        free = max(lines - len(page.lines), 0)
        first = {"top": 0, "bottom": free}.get(page.vertical, free // 2)
        for number, line in enumerate(page.lines[:lines]):
            place = {"left": str.ljust, "right": str.rjust}.get(line.justify, str.center)
            rows[first + number] = place(line.text, characters)
    return tuple(row.ljust(characters)[:characters] for row in rows)


def as_text(page: Page | None, lines: int, characters: int) -> str:
    """Return the face as text in a frame."""
    edge = "+" + "-" * (characters + 2) + "+"
    rows = [f"| {row} |" for row in rows_of(page, lines, characters)]
    return "\n".join([edge, *rows, edge])


def png(page: Page | None, lines: int, characters: int) -> bytes:
    """Return the face as a PNG picture."""
    columns = 2 * MARGIN + characters * (WIDTH_PX + GAP) - GAP
    rows = 2 * MARGIN + lines * (HEIGHT_PX + GAP) - GAP
    size = columns * PITCH, rows * PITCH
    lit = Image.new("RGB", size, PANEL)
    amber, glow = Image.new("RGB", size, LIT), Image.new("L", size, 0)
    draw, glowing = ImageDraw.Draw(lit), ImageDraw.Draw(glow)
    for number, row in enumerate(rows_of(page, lines, characters)):
        for place, character in enumerate(row):
            left = MARGIN + place * (WIDTH_PX + GAP)
            top = MARGIN + number * (HEIGHT_PX + GAP)
            _character(draw, glowing, character, left, top)
    blurred = glow.filter(ImageFilter.GaussianBlur(PITCH * 0.45))
    face = Image.blend(lit, Image.composite(amber, lit, blurred), 0.45)
    picture = Image.new("RGB", (size[0] + 2 * PITCH, size[1] + 2 * PITCH), FRAME)
    picture.paste(face, (PITCH, PITCH))
    buffer = BytesIO()
    picture.save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


def _character(
    draw: ImageDraw.ImageDraw, glow: ImageDraw.ImageDraw, character: str, left: int, top: int
) -> None:
    """Draw one character cell: every diode of it, lit or dark."""
    columns = COLUMNS.get(character, COLUMNS[" "])
    for column in range(WIDTH_PX):
        for row in range(HEIGHT_PX):
            x, y = (left + column) * PITCH, (top + row) * PITCH
            on = columns[column] >> row & 1
            box = (x + 1, y + 1, x + PITCH - 2, y + PITCH - 2)
            draw.ellipse(box, fill=LIT if on else DARK)
            if on:
                glow.ellipse(box, fill=255)
