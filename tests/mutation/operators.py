"""Mutants of a source text: one small edit each, everything else as it was.

A comparison, an arithmetic operator, a constant, a condition or a called statement is exchanged.
What no test should look at stays: docstrings, annotations, decorators, ``__all__``, what is written
to logs, and what a ``raise`` says.
"""

from __future__ import annotations

import ast
import bisect
import io
import re
import tokenize
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

Kind: TypeAlias = Literal["arithmetic", "call", "comparison", "condition", "constant"]

_COMPARISONS: dict[type[ast.cmpop], tuple[str, str]] = {
    ast.Lt: ("<", "<="),
    ast.LtE: ("<=", "<"),
    ast.Gt: (">", ">="),
    ast.GtE: (">=", ">"),
    ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
    ast.Is: ("is", "is not"),
    ast.IsNot: ("is not", "is"),
    ast.In: ("in", "not in"),
    ast.NotIn: ("not in", "in"),
}
_ARITHMETIC: dict[type[ast.operator], tuple[str, str]] = {
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: ("*", "/"),
    ast.Div: ("/", "*"),
    ast.FloorDiv: ("//", "*"),
    ast.Mod: ("%", "*"),
    ast.Pow: ("**", "*"),
    ast.LShift: ("<<", ">>"),
    ast.RShift: (">>", "<<"),
    ast.BitAnd: ("&", "|"),
    ast.BitOr: ("|", "&"),
    ast.BitXor: ("^", "&"),
}
_TOLD = re.compile(r"warn|print|echo|debug|info|warning|error|exception|\w*Error|TypeVar|NewType")
"""What is called for people, or type checkers, to read."""
_NAMING = re.compile(r"require_\w+|invalid")
"""What is called with the name of an argument, among others."""


@dataclass(frozen=True, slots=True)
class Mutant:
    """One edit of one file."""

    file: str
    """Relative to the repository."""
    line: int
    kind: Kind
    start: int
    end: int
    """Which characters of the file are replaced."""
    replacement: str
    before: str
    """The line of the edit, or several joined, with single spaces."""
    after: str

    def apply(self, source: str) -> str:
        """The whole mutated file."""
        return source[: self.start] + self.replacement + source[self.end :]


def find_mutants(file: str, source: str) -> list[Mutant]:
    """All mutants of a module, in the order of the source."""
    finder = _Finder(file, source)
    finder.visit(ast.parse(source))
    return sorted(finder.found, key=lambda mutant: (mutant.start, mutant.end, mutant.replacement))


class _Finder(ast.NodeVisitor):
    def __init__(self, file: str, source: str) -> None:
        self.found: list[Mutant] = []
        self._file, self._source = file, source
        self._lines = source.splitlines(keepends=True)
        self._starts = [0]
        for line in self._lines:
            self._starts.append(self._starts[-1] + len(line))
        tokens = tokenize.generate_tokens(io.StringIO(source).readline)
        self._tokens = [
            (self._starts[token.start[0] - 1] + token.start[1], token.string)
            for token in tokens
            if token.type in (tokenize.OP, tokenize.NAME)
        ]

    # What stays.

    def visit_FunctionDef(self, node: ast.FunctionDef | ast.AsyncFunctionDef) -> None:
        defaults = [*node.args.defaults, *node.args.kw_defaults]
        self._visit_all([default for default in defaults if default is not None])
        self._visit_all(node.body)

    def visit_AsyncFunctionDef(self, node: ast.AsyncFunctionDef) -> None:
        self.visit_FunctionDef(node)

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        self._visit_all(node.body)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value is not None:
            self.visit(node.value)

    def visit_Assign(self, node: ast.Assign) -> None:
        names = {target.id for target in node.targets if isinstance(target, ast.Name)}
        if not names & {"__all__", "__slots__"}:
            self.generic_visit(node)

    def visit_Raise(self, node: ast.Raise) -> None:
        pass

    def visit_Assert(self, node: ast.Assert) -> None:
        pass

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        pass

    def visit_Call(self, node: ast.Call) -> None:
        name = _name(node)
        if _TOLD.fullmatch(name):
            return
        if _NAMING.fullmatch(name):
            values = [*node.args, *(keyword.value for keyword in node.keywords)]
            self._visit_all([value for value in values if not _is_text(value)])
            return
        self.generic_visit(node)

    def visit_Subscript(self, node: ast.Subscript) -> None:
        if not (isinstance(node.value, ast.Name) and node.value.id == "Literal"):
            self.generic_visit(node)

    # What is exchanged.

    def visit_Expr(self, node: ast.Expr) -> None:
        if isinstance(node.value, ast.Constant):
            return
        call = node.value.value if isinstance(node.value, ast.Await) else node.value
        if isinstance(call, ast.Call) and not _TOLD.fullmatch(_name(call)):
            self._replace(node, "pass", "call")
        self.generic_visit(node)

    def visit_If(self, node: ast.If) -> None:
        names = {name.id for name in ast.walk(node.test) if isinstance(name, ast.Name)}
        if names & {"TYPE_CHECKING", "__name__"}:
            self._visit_all(node.orelse)
            return
        self._condition(node.test)
        self.generic_visit(node)

    def visit_IfExp(self, node: ast.IfExp) -> None:
        self._condition(node.test)
        self.generic_visit(node)

    def visit_While(self, node: ast.While) -> None:
        self._condition(node.test)
        self.generic_visit(node)

    def visit_comprehension(self, node: ast.comprehension) -> None:
        for test in node.ifs:
            self._condition(test)
        self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> None:
        old, new = ("and", "or") if isinstance(node.op, ast.And) else ("or", "and")
        for left, right in zip(node.values, node.values[1:], strict=False):
            self._exchange(left, right, old, new, "condition")
        self.generic_visit(node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        kind: Kind = "condition" if isinstance(node.op, ast.Not) else "arithmetic"
        begin = self._start(node)
        length = len("not") if isinstance(node.op, ast.Not) else 1
        self._edit(begin, begin + length, "", kind)
        self.generic_visit(node)

    def visit_Compare(self, node: ast.Compare) -> None:
        for left, operator, right in zip(
            [node.left, *node.comparators], node.ops, node.comparators, strict=False
        ):
            self._exchange(left, right, *_COMPARISONS[type(operator)], "comparison")
        self.generic_visit(node)

    def visit_BinOp(self, node: ast.BinOp) -> None:
        # @ has no counterpart; + and % of texts are no arithmetic.
        if type(node.op) in _ARITHMETIC and not (_is_text(node.left) or _is_text(node.right)):
            self._exchange(node.left, node.right, *_ARITHMETIC[type(node.op)], "arithmetic")
        self.generic_visit(node)

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        if type(node.op) in _ARITHMETIC:
            old, new = _ARITHMETIC[type(node.op)]
            self._exchange(node.target, node.value, f"{old}=", f"{new}=", "arithmetic")
        self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        other = _another(node.value)
        if other is not None:
            self._replace(node, other, "constant")

    def _condition(self, test: ast.expr) -> None:
        """Negate a condition that has no operator of its own."""
        if not isinstance(test, ast.Compare | ast.BoolOp | ast.UnaryOp | ast.Constant):
            self._replace(test, f"not ({ast.get_source_segment(self._source, test)})", "condition")

    def _exchange(self, left: ast.expr, right: ast.expr, old: str, new: str, kind: Kind) -> None:
        """Replace the operator between two operands."""
        begin, end = self._end(left), self._start(right)
        between = [(place, text) for place, text in self._tokens if begin <= place < end]
        words = old.split()
        for index, (place, _) in enumerate(between):
            found = between[index : index + len(words)]
            if [text for _, text in found] == words:
                self._edit(place, found[-1][0] + len(words[-1]), new, kind)
                return

    def _replace(self, node: ast.expr | ast.stmt, replacement: str, kind: Kind) -> None:
        self._edit(self._start(node), self._end(node), replacement, kind)

    def _edit(self, start: int, end: int, replacement: str, kind: Kind) -> None:
        first = bisect.bisect_right(self._starts, start) - 1
        last = bisect.bisect_left(self._starts, end) - 1
        begin, finish = self._starts[first], self._starts[last + 1]
        before = self._source[begin:finish]
        after = before[: start - begin] + replacement + before[end - begin :]
        self.found.append(
            Mutant(
                file=self._file,
                line=first + 1,
                kind=kind,
                start=start,
                end=end,
                replacement=replacement,
                before=" ".join(before.split()),
                after=" ".join(after.split()),
            )
        )

    def _visit_all(self, nodes: Sequence[ast.AST]) -> None:
        for node in nodes:
            self.visit(node)

    def _start(self, node: ast.expr | ast.stmt) -> int:
        return self._place(node.lineno, node.col_offset)

    def _end(self, node: ast.expr | ast.stmt) -> int:
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        return self._place(node.end_lineno, node.end_col_offset)

    def _place(self, line: int, column: int) -> int:
        # ast counts bytes.
        return self._starts[line - 1] + len(self._lines[line - 1].encode()[:column].decode())


def _name(call: ast.Call) -> str:
    match call.func:
        case ast.Name(id=name) | ast.Attribute(attr=name):
            return name
        case _:
            return ""


def _is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.JoinedStr) or (
        isinstance(node, ast.Constant) and isinstance(node.value, str)
    )


def _another(value: object) -> str | None:
    """Source of another constant of the same type; None: it stays."""
    match value:
        case bool():
            return str(not value)
        case int():
            return str(value + 1)
        case float():
            return repr(2 * value if value else 1.0)
        case str():
            # With a space it is a sentence, or SQL, which fails whatever is changed in it.
            return None if re.search(r"\s", value) else repr("" if value else "mutated")
        case bytes():
            return repr(b"" if value else b"mutated")
        case _:
            return None
