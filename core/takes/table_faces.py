"""Which face a row of a table shows, and which columns of several nodes count (takes.md)."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence

from ..errors import DataError, Message
from ..face.names import half_of

_FACE = re.compile(r"(?:face|person|people|subject)(?:id|index|no|nr|number)")
"""Titles of the number of a face, as letters in lower case."""
_NODE = re.compile(r"^(.*)[.|:/\[(](?=...)")
"""That of a node before the name of a coefficient."""


def rows_of_one_face(rows: list[list[str]], head: Sequence[str]) -> tuple[list[list[str]], list[str]]:
    """Return the rows of the face that has most, the first of several, and what was left out."""
    titles = [re.sub(r"[\W\d_]", "", title.lower()) for title in head]
    place = next((number for number, title in enumerate(titles) if _FACE.fullmatch(title)), None)
    if place is None:
        return rows, []
    faces = [row[place] if place < len(row) else "" for row in rows]
    counts = Counter(faces)
    if len(counts) == 1:
        return rows, []
    ((face, _),) = counts.most_common(1)
    note = Message("The table has {count} faces. Only face {face} was read.", count=len(counts), face=face)
    return [row for row, of in zip(rows, faces, strict=True) if of == face], [note]


def columns_of_one_node(columns: Mapping[int, int], head: Sequence[str]) -> tuple[dict[int, int], list[str]]:
    """Return the coefficients of columns, each once, and what was left out.

    Of the same coefficient under several nodes, as in `Head|jawOpen` and `Teeth|jawOpen`, the one counts whose node has
    most coefficients, or the first; its halves, such as `browInnerUp_L`, both count. ValueError if nothing tells two
    columns apart.
    """
    nodes = {column: node[1] if (node := _NODE.match(head[column])) else "" for column in columns}
    counts = Counter(nodes.values())
    kept: dict[int, int] = {}
    for column in sorted(columns, key=lambda column: -counts[nodes[column]]):
        same = [other for other, place in kept.items() if place == columns[column]]
        beside = [other for other in same if nodes[other] == nodes[column]]
        if half_of(head[column]) in {half_of(head[other]) for other in beside}:
            raise DataError("two of its columns are the same coefficient")
        if len(beside) == len(same):
            kept[column] = columns[column]
    notes: list[str] = []
    if len(kept) < len(columns):
        name = counts.most_common(1)[0][0]
        notes.append(Message("Several nodes have the same coefficients. Those of {name} were used.", name=name))
    return dict(sorted(kept.items())), notes
