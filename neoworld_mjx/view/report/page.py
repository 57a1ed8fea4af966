"""Building blocks of a report page: style, tables, pictures as data URIs; all text is escaped."""

import base64
import io
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ...errors import RunError
from ...io import file_bounds, open_image
from ...io.files import MIB, read_bytes

_MAX_PX = 1280
_SMALL_BYTES = 300_000

STYLE = """
:root { --ink:#1d2126; --dim:#667079; --line:#dfe3e7; --paper:#fff; --ground:#f5f6f7;
  --c1:#1f6fb2; --c2:#c2571a; --c3:#3c8d5a; --band:#1f6fb222;
  --good:#217a45; --bad:#b3261e; --warn:#8a5a00; --warnbg:#fff5dc; --warnline:#e8c877; }
@media (prefers-color-scheme: dark) { :root { --ink:#e7eaed; --dim:#98a2ab; --line:#343a40;
  --paper:#1d2125; --ground:#15181b; --c1:#69aee6; --c2:#ee9a63; --c3:#79c797; --band:#69aee626;
  --good:#7acb98; --bad:#ff9a91; --warn:#f2cf7e; --warnbg:#332a14; --warnline:#6d5925; } }
* { box-sizing: border-box; }
body { margin:0; background:var(--ground); color:var(--ink); line-height:1.45;
  font:15px/1.45 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial,
  sans-serif; }
main { max-width:1120px; margin:0 auto; padding:28px 24px 60px; }
h1 { font-size:26px; margin:0 0 2px; letter-spacing:-.01em; }
h2 { font-size:17px; margin:0 0 12px; }
h3 { font-size:14px; margin:18px 0 6px; }
p { margin:6px 0; }
section { background:var(--paper); border:1px solid var(--line); border-radius:8px;
  padding:18px 20px; margin-top:16px; }
.dim, .missing { color:var(--dim); } .missing { font-style:italic; }
.good { color:var(--good); } .bad { color:var(--bad); }
.warn { background:var(--warnbg); border-color:var(--warnline); }
.warn h2 { color:var(--warn); }
.warn ul { margin:0; padding-left:20px; }
.cards { display:grid; grid-template-columns:repeat(auto-fit,minmax(200px,1fr)); gap:16px 20px; }
.card .value { font-size:23px; font-weight:600; font-variant-numeric:tabular-nums;
  white-space:nowrap; }
.card .name { color:var(--dim); font-size:13px; } .card .limit { color:var(--dim); font-size:12px; }
.pictures { display:grid; grid-template-columns:repeat(auto-fit,minmax(280px,1fr)); gap:14px; }
figure { margin:0; } figure img { width:100%; display:block; border-radius:4px; }
figcaption { color:var(--dim); font-size:13px; margin-top:5px; }
.thumbs { display:flex; gap:10px; margin:6px 0 10px; } .thumbs figure { width:190px; }
.scroll { overflow-x:auto; margin-top:10px; }
table { border-collapse:collapse; width:100%; font-variant-numeric:tabular-nums; font-size:14px; }
th { text-align:left; color:var(--dim); font-weight:500; border-bottom:1px solid var(--line);
  padding:4px 12px 4px 0; white-space:nowrap; }
td { border-bottom:1px solid var(--line); padding:5px 12px 5px 0; vertical-align:top; }
tr:last-child td { border-bottom:0; }
td:last-child:not(.num) { min-width:16em; }
.num { text-align:right; white-space:nowrap; } th.num { text-align:right; }
.charts { display:grid; grid-template-columns:repeat(auto-fit,minmax(340px,1fr)); gap:18px; }
.chart svg { width:100%; height:auto; display:block; }
.legend { display:flex; flex-wrap:wrap; gap:4px 16px; } .legend svg { width:26px; height:12px;
  display:inline-block; vertical-align:middle; margin-right:6px; }
.grid { stroke:var(--line); stroke-width:1; }
.tick { fill:var(--dim); font-size:12px; } .axis { fill:var(--dim); font-size:12.5px; }
details summary { cursor:pointer; color:var(--dim); }
.object { border-top:1px solid var(--line); padding:10px 0; }
.object > summary { display:grid; grid-template-columns:minmax(190px,300px) 1fr auto; gap:4px 18px;
  align-items:start; color:var(--ink); list-style:none; }
.object > summary::-webkit-details-marker { display:none; }
.object .shots { display:flex; gap:8px; min-height:20px; }
.object .shots figure { flex:1; min-width:0; }
.object .shots img { max-height:150px; object-fit:contain; background:var(--ground); }
.object b { font-size:15px; } .object .verdict { text-align:right; }
.object dl { margin:4px 0 0; display:grid; grid-template-columns:auto 1fr; gap:0 10px;
  font-size:13.5px; } .object dt { color:var(--dim); } .object dd { margin:0; }
#scene-3d { width:100%; height:min(60vh,520px); display:block; border-radius:4px; cursor:grab;
  touch-action:none; background:#dbe0e5; }
#scene-3d-controls { display:grid; grid-template-columns:repeat(auto-fit,minmax(230px,1fr));
  gap:6px 18px; margin-top:8px; font-size:13px; }
#scene-3d-controls label { display:flex; gap:8px; justify-content:space-between; }
#scene-3d-controls label[hidden] { display:none; }
@media (max-width:640px) { .cards { grid-template-columns:1fr 1fr; }
  main { padding:14px 8px 40px; } section { padding:14px 12px; }
  .object > summary { grid-template-columns:1fr auto; } .object .shots { grid-column:1 / -1; } }
@media print { body { background:#fff; } #scene-3d-controls { display:none; }
  section { break-inside:avoid-page; border:0; } }
code, pre { font-family:ui-monospace, Menlo, Consolas, monospace; font-size:13px; }
pre { white-space:pre-wrap; overflow-wrap:anywhere; margin:8px 0 0; }
"""


class Html(str):
    """Text that is HTML already; everything else is escaped."""

    __slots__ = ()


def text(value: object) -> Html:
    """Escape a value for HTML."""
    return value if isinstance(value, Html) else Html(escape(str(value)))


def document(title: str, body: Iterable[str], scripts: Iterable[str] = ()) -> str:
    """Put sections into a whole page that needs nothing from outside.

    The content policy forbids network access and all scripts but our own, whatever slipped in.

    Args:
        title: of the page.
        body: its sections.
        scripts: hashes of the scripts that may run, as a content policy names them.
    """
    policy = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
    allowed = " ".join(scripts)
    policy += f"; script-src {allowed}" if allowed else ""
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{text(title)}</title><style>{STYLE}</style></head>"
        f"<body><main>\n{chr(10).join(body)}\n</main></body></html>\n"
    )


def section(title: str, *content: str, kind: str = "") -> Html:
    """Put HTML into a titled box."""
    opened = f'<section class="{kind}">' if kind else "<section>"
    return Html(f"{opened}<h2>{text(title)}</h2>{''.join(content)}</section>")


def missing(note: str) -> Html:
    """Say that something is not there."""
    return Html(f'<p class="missing">{text(note)}</p>')


def table(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> Html:
    """Draw a table; columns whose head begins with "#" hold numbers and are set to the right."""
    kinds = [' class="num"' if head.startswith("#") else "" for head in heads]
    top = "".join(
        f"<th{kind}>{text(head.lstrip('#'))}</th>" for head, kind in zip(heads, kinds, strict=True)
    )
    body = "".join(
        "<tr>"
        + "".join(f"<td{kind}>{text(cell)}</td>" for cell, kind in zip(row, kinds, strict=True))
        + "</tr>"
        for row in rows
    )
    return Html(
        f'<div class="scroll"><table><thead><tr>{top}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def verdict(passed: bool | None) -> Html:
    """Write a verdict; None is unknown."""
    if passed is None:
        return Html('<span class="dim">unknown</span>')
    return Html('<span class="good">✓ pass</span>' if passed else '<span class="bad">✗ fail</span>')


def card(name: str, value: object, limit: str = "", passed: bool | None = None) -> Html:
    """Show one number with its threshold; a verdict colours it."""
    colour = "" if passed is None else (" good" if passed else " bad")
    return Html(
        f'<div class="card"><div class="value{colour}">{text(value)}</div>'
        f'<div class="name">{text(name)}</div><div class="limit">{text(limit)}</div></div>'
    )


def picture(path: Path, caption: str) -> Html:
    """Embed a picture file, shrunk if it is large; a note stands for an absent or broken one."""
    if not path.is_file():
        return Html(
            f"<figure>{missing('not there yet')}<figcaption>{text(caption)}</figcaption></figure>"
        )
    try:
        source = _data_uri(path)
    except (OSError, RunError):
        note = missing(f"{path.name} cannot be read")
        return Html(f"<figure>{note}<figcaption>{text(caption)}</figcaption></figure>")
    return Html(
        f'<figure><img src="{source}" alt="{text(caption)}">'
        f"<figcaption>{text(caption)}</figcaption></figure>"
    )


def cut_out(
    path: Path, window: tuple[float, float, float, float], caption: str, height: int = 150
) -> Html:
    """Embed a part of a picture.

    Args:
        path: the picture file.
        window: left, top, right, bottom, as shares of the picture.
        caption: of the part.
        height: in pixels, at most; a smaller part stays as it is.
    """
    try:
        raw = read_bytes(path, file_bounds().max_picture_mib * MIB)
        with open_image(raw, path.name, RunError) as image:
            image.load()
            x0, y0, x1, y1 = (
                round(min(max(share, 0.0), 1.0) * size)
                for share, size in zip(window, (*image.size, *image.size), strict=True)
            )
            part = image.convert("RGB").crop((x0, y0, max(x1, x0 + 1), max(y1, y0 + 1)))
    except (OSError, RunError):
        return Html("")
    part.thumbnail((2 * height, height), Image.Resampling.LANCZOS)
    return embedded(np.asarray(part), caption)


def film_strip(path: Path, name: str, frames: int = 5) -> Html:
    """Embed some frames of an animation side by side; nothing where there is no such file."""
    try:
        raw = read_bytes(path, file_bounds().max_picture_mib * MIB)
        with open_image(raw, path.name, RunError) as image:
            count = getattr(image, "n_frames", 1)
            shown = []
            for k in np.linspace(0, count - 1, min(frames, count)).astype(int):
                image.seek(int(k))
                shown.append(np.asarray(image.convert("RGB")))
    except (EOFError, OSError, RunError):
        return Html("")
    return embedded(np.concatenate(shown, axis=1), f"{name}, {len(shown)} frames of {path.name}")


def embedded(pixels: NDArray, caption: str) -> Html:
    """Embed a picture, uint8 [h, w, 3]."""
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "JPEG", quality=85)
    source = f"data:image/jpeg;base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"
    return Html(
        f'<figure><img src="{source}" alt="{text(caption)}">'
        f"<figcaption>{text(caption)}</figcaption></figure>"
    )


def _data_uri(path: Path) -> str:
    raw = read_bytes(path, file_bounds().max_picture_mib * MIB)
    with open_image(raw, path.name, RunError) as image:
        image.load()
        kind = (image.format or "").lower()
        if kind != "png" or len(raw) > _SMALL_BYTES:
            image.thumbnail((_MAX_PX, _MAX_PX), Image.Resampling.LANCZOS)
            buffer = io.BytesIO()
            image.convert("RGB").save(buffer, "JPEG", quality=88)
            raw, kind = buffer.getvalue(), "jpeg"
    return f"data:image/{kind};base64,{base64.b64encode(raw).decode('ascii')}"
