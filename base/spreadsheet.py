"""Convert CSV as written by spreadsheets and people into one plain form."""

import csv
import io
import re
from pathlib import Path

from tulip_testbed.base.errors import InputError

DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
DECIMAL_POINT = re.compile(r"[+-]?\d*\.\d+([eE][+-]?\d+)?")
SEPARATOR_LINE = re.compile(r'"?sep=[,;\t]?"?', re.IGNORECASE)
SEPARATORS, NUMBER = re.compile(r"[,;\t]"), re.compile(r'[\s"]*[+-]?\.?\d')
COMMENT = re.compile(r'[\s"]*#[\s"#]*')  # values lose the space around them, of any kind
NOT_VALUES = str.maketrans("", "", ',;"')  # without them an empty line is only space


def plain_csv(path: Path, content: bytes) -> bytes:
    """Return a CSV with commas between values, points within numbers and one line per posture.

    Also accepted are a byte order mark, any line ends, spaces around names and values, empty lines and
    columns, lines that begin with #, names in one of those right before the numbers, Excel's first line
    `sep=;`, semicolons or tabs between values and, with these, decimal commas.
    """
    every = list(enumerate(_text(path, content).split("\n"), 1))
    lines = [one for one in every if not COMMENT.match(one[1]) and one[1].translate(NOT_VALUES).strip()]
    if lines and SEPARATOR_LINE.fullmatch(lines[0][1].strip()):
        del lines[0]
    if lines and NUMBER.match(lines[0][1]):  # numpy writes names as a comment
        number, line = every[max(lines[0][0] - 2, 0)]
        names = COMMENT.sub("", line, count=1)
        if COMMENT.match(line) and len(SEPARATORS.findall(names)) == len(SEPARATORS.findall(lines[0][1])) > 0:
            lines.insert(0, (number, names))
    if not lines:
        raise InputError(f"{path}: found no line with column names")
    header = re.sub(r'"[^"]*"', "", lines[0][1])
    separator = max(",;\t", key=header.count)
    after_quote = re.compile(rf'"[^\S\t]+({separator}|$)')
    texts = [after_quote.sub(r'"\1', line) for _, line in lines]
    try:
        reader = csv.reader(texts, delimiter=separator, skipinitialspace=True, strict=True)
        rows = [[value.strip() for value in row] for row in reader]
    except csv.Error as error:
        raise InputError(f"{path}: not a CSV file ({error})") from None
    if len(rows) < len(lines):
        raise InputError(f"{path}: found a value that spans two lines, expected one line per posture")
    width = len(rows[0])
    while width and not rows[0][width - 1] and not any(any(row[width - 1 : width]) for row in rows):
        width -= 1
    if width == 0:
        raise InputError(f"{path}: found no line with column names")
    for (number, _), row in zip(lines, rows, strict=True):
        found = max((k + 1 for k, value in enumerate(row) if value), default=0)
        if found > width or len(row) < width:
            raise InputError(
                f"{path}: line {number}: found {len(row)} values, expected {width}, one per column name"
            )
    if separator != ",":
        rows = _decimal_points(path, rows)
    out = io.StringIO()
    # A name with a separator would be taken for several.
    quoting = csv.QUOTE_ALL if any(SEPARATORS.search(name) for name in rows[0]) else csv.QUOTE_MINIMAL
    csv.writer(out, lineterminator="\n", quoting=quoting).writerows(row[:width] for row in rows)
    return out.getvalue().encode()


def _text(path: Path, content: bytes) -> str:
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: byte {error.start} is not UTF-8; save it as 'CSV UTF-8' (Excel) or UTF-8 (LibreOffice)"
        ) from None
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _decimal_points(path: Path, rows: list[list[str]]) -> list[list[str]]:
    """Replace decimal commas by points; refuse both, since one may separate thousands."""
    values = [value for row in rows[1:] for value in row]
    comma = next((value for value in values if DECIMAL_COMMA.fullmatch(value)), None)
    point = next((value for value in values if DECIMAL_POINT.fullmatch(value)), None)
    if comma and point:
        raise InputError(
            f"{path}: found both {comma} and {point}, expected one decimal sign; "
            "set all columns to plain numbers before exporting"
        )
    return [
        [value.replace(",", ".") if DECIMAL_COMMA.fullmatch(value) else value for value in row]
        for row in rows
    ]
