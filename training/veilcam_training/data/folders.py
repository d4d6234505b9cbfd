"""Folders of pictures: the parts and classes that their names tell."""

import re
import unicodedata
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Literal, NoReturn

from veilcam_optics.pictures import choose_pictures, in_words, is_hidden
from veilcam_training.errors import TrainingError

Part = Literal["train", "validation", "test"]
Tree = dict[str, list[tuple[str, ...]]]
"""Pictures by the first folder of their path; "" holds those that lie in none."""

DESCRIPTION = "dataset.toml"
PART_NAMES: Mapping[str, Part] = {
    **dict.fromkeys(("train", "training"), "train"),
    **dict.fromkeys(("val", "valid", "validation"), "validation"),
    **dict.fromkeys(("test", "testing"), "test"),
}
"""Usual names of parts, in small letters."""
NAMED = 10
"""Folders that a refusal names."""
_LIKE_A_PART = re.compile(
    r"((train|test)(ing)?|val|valid|validation|dev|eval|evaluation)"
    r"([-_ ]?(set|data|images?|pictures?|split|part))?([-_ ]?\d+)?"
    r"|(split|fold|subset)[-_ ]?\d+",
    re.IGNORECASE,
)
_BESIDE = "beside the folders of classes"


@dataclass(frozen=True)
class Layout:
    """Pictures in folders, each with its class and its part."""

    pictures: tuple[tuple[Path, str, Part | None], ...]
    remarks: tuple[str, ...]
    """What was passed over, and what was understood otherwise than usual."""


def shown(name: object) -> str:
    """Return a name as a terminal can show it, whatever bytes it is made of."""
    return "".join(each if each.isprintable() else ascii(each)[1:-1] for each in str(name))


def find_layout(folder: Path) -> Layout | None:
    """Return the pictures in a folder of classes or of parts, in a fixed order.

    Parts have their usual names, in any case. A class holds all pictures below its folder.

    Args:
        folder: folder of the data set.

    Returns:
        None where fewer than two classes and no parts are found.

    Raises:
        TrainingError: names of folders leave open what is a part and what a class, or a folder
            cannot be read.
    """
    if not folder.is_dir():
        return None
    paths, others = pictures_below(folder)
    tree = _tree(path.relative_to(folder).parts for path in paths)
    named = [name for name in tree if _part(name)]
    remarks: list[str] = []
    if named:
        roots = _parts(folder, tree, named, others, remarks)
    elif len(tree) - ("" in tree) > 1:
        roots = {None: ""}
    else:
        _check_wrapped(folder, tree)
        return None
    found: list[tuple[Path, str, Part | None]] = []
    for part, root in roots.items():
        inside = _tree(parts[1:] for parts in tree[root]) if root else dict(tree)
        others[_BESIDE] += len(inside.pop("", ()))
        _check_classes(folder / root, inside)
        found += [
            (folder / root / Path(*parts), name, part)
            for name in sorted(inside)
            for parts in sorted(inside[name])
        ]
        unread = sorted(shown(each) for each in _names(folder / root) - inside.keys())
        if unread:
            remarks.append(f"no picture is read in {', '.join(unread)}: no class")
    if passed := +others:
        remarks.insert(0, f"passed over: {in_words(passed)}")
    return Layout(tuple(found), tuple(remarks))


def pictures_below(folder: Path) -> tuple[list[Path], Counter[str]]:
    """Return the pictures in a folder and all folders in it, and the number of other files by kind.

    Raises:
        TrainingError: a folder cannot be read.
    """
    return choose_pictures(_entries(folder, folder.resolve(), set()))


def _entries(folder: Path, root: Path, followed: set[Path]) -> Iterator[Path]:
    """Files below a folder, and folders that are not entered: hidden ones and links back."""
    try:
        inside = sorted(folder.iterdir())
    except OSError as error:
        raise TrainingError(f"{shown(folder)} cannot be read ({error.strerror})") from None
    for path in inside:
        if path.name == DESCRIPTION and folder.resolve() == root:
            continue
        if not path.is_dir() or is_hidden(path):
            yield path
            continue
        if path.is_symlink():
            real = path.resolve()
            if real in followed or real.is_relative_to(root) or root.is_relative_to(real):
                yield path
                continue
            followed.add(real)
        yield from _entries(path, root, followed)


def _tree(pictures: Iterable[tuple[str, ...]]) -> Tree:
    tree: Tree = {}
    for parts in pictures:
        tree.setdefault(composed(parts[0]) if len(parts) > 1 else "", []).append(parts)
    return tree


def composed(name: str) -> str:
    """Return a name in Unicode's composed form (NFC): a Mac writes the other one."""
    return unicodedata.normalize("NFC", name)


def _part(name: str) -> Part | None:
    return PART_NAMES.get(name.casefold())


def _names(folder: Path) -> set[str]:
    inside = (path for path in folder.iterdir() if path.is_dir() and not is_hidden(path))
    return {composed(path.name) for path in inside}


def _parts(
    folder: Path, tree: Tree, named: Sequence[str], others: Counter[str], remarks: list[str]
) -> dict[Part | None, str]:
    """Return the folder of each part; where there is no test set, that to validate tests."""
    roots: dict[Part | None, str] = {}
    for name in named:
        if (part := _part(name)) in roots:
            _refuse(folder, f"{roots[part]} and {name} are both the {part} part")
        roots[part] = name
    rest = [name for name in tree if name and name not in named]
    understood = f"{_listed(named)} as parts and {_listed(rest)} as classes"
    if rest and (len(roots) == 1 or any(map(_LIKE_A_PART.fullmatch, rest))):
        _refuse(folder, f"it was understood to hold {understood}")
    if "train" not in roots:
        _refuse(folder, f"it holds {_listed(named)}, and no train")
    for name in named:
        if all(len(parts) == 2 for parts in tree[name]):
            _refuse(folder, f"{name} is a part whose pictures lie in no folders of classes")
    if rest:
        others[f"outside {_listed(named)}"] += sum(len(tree[name]) for name in rest)
    others[_BESIDE] += len(tree.get("", ()))
    if len(roots) == 1:
        remarks.append(f"{named[0]} is the only part: some of its pictures test")
        return {None: named[0]}
    if "test" not in roots:
        remarks.append(f"there is no test part: {roots['validation']} tests")
        roots["test"] = roots.pop("validation")
    return roots


def _check_wrapped(folder: Path, tree: Tree) -> None:
    """Refuse a folder whose only folder holds the parts or the classes."""
    for name in filter(None, tree):
        inside = {parts[1] for parts in tree[name] if len(parts) > 2}
        if len(inside) > 1 or any(map(_part, inside)):
            raise TrainingError(
                f"{shown(folder)} holds one folder alone, {shown(name)}, with {_listed(inside)} "
                f"in it: give {shown(folder / name)} as --data"
            )


def _check_classes(root: Path, classes: Tree) -> None:
    """Refuse classes that may be parts, by their names or by the folders in them."""
    if like := [name for name in classes if _LIKE_A_PART.fullmatch(name)]:
        _refuse(
            root,
            f"it was understood to hold the classes {_listed(classes)}, and "
            f"{_listed(like)} may be parts",
        )
    below = {
        name: {composed(parts[1]) for parts in pictures if len(parts) > 2}
        for name, pictures in classes.items()
    }
    for name, inside in below.items():
        if any(map(_part, inside)):
            _refuse(root, f"the class {shown(name)} holds {_listed(inside)}")
    for (one, first), (other, second) in combinations(below.items(), 2):
        if (first and first == second) or len(first & second) > 1:
            _refuse(
                root,
                f"{_listed((one, other))} were understood as classes, and both hold "
                f"{_listed(first & second)}",
            )


def _listed(names: Iterable[str]) -> str:
    """Return the first of some names, in words."""
    ordered = [shown(name) for name in sorted(names) if name]
    more = f" and {len(ordered) - NAMED} more" if len(ordered) > NAMED else ""
    return f"{', '.join(ordered[:NAMED])}{more}"


def _refuse(folder: Path, understood: str) -> NoReturn:
    raise TrainingError(
        f"{shown(folder)}: {understood}: use CLASS/, or train/CLASS/ and test/CLASS/, or name "
        "every picture in labels.csv"
    )
