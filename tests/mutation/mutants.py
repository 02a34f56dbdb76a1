"""Faults that somebody could have written into a module, one a mutant. Knows source text, no module and no test.

Operators, numbers and conditions are changed by `cosmic-ray`. What it lets alone is what a table is made
of: entries, which are left out here one by one, and names of constants, which are exchanged for the next
one of their kind.
"""

import ast
import difflib
from collections.abc import Iterator
from dataclasses import dataclass

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.operators.provider import OperatorProvider


@dataclass(frozen=True, slots=True, kw_only=True)
class Mutant:
    """A module with one change, `change` being its lines before and after it."""

    line: int
    change: str
    source: str


def mutants_of(source: str) -> Iterator[Mutant]:
    """All mutants that may behave differently; annotations and docstrings do nothing."""
    meaning = _meaning(source)
    seen = {meaning}
    for mutated in (*_by_operator(source), *_by_name(source), *_by_entry(source)):
        try:
            found = _meaning(mutated)
        except SyntaxError:
            continue
        if found not in seen:
            seen.add(found)
            yield Mutant(**_difference(source, mutated), source=mutated)


def _by_operator(source: str) -> Iterator[str]:
    provider = OperatorProvider()
    tree = get_ast(source)
    for name in provider:
        kind = provider[name]
        if kind.arguments():
            continue
        operator = kind()
        places = sum(1 for node in ast_nodes(tree) for _ in operator.mutation_positions(node))
        for place in range(places):
            mutated = mutate_code(source, operator, place)
            if mutated is not None:
                yield mutated


def _by_name(source: str) -> Iterator[str]:
    """Constants exchanged: `_S.FAULT` for the next name used with `_S`, CONTROLWORD_X for the next."""
    tree = ast.parse(source)
    kinds: dict[str, list[str]] = {}
    uses: list[tuple[ast.expr, str, str]] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            kind, name = f"{node.value.id}.", node.attr
        elif isinstance(node, ast.Name):
            kind, name = node.id.partition("_")[0] + "_", node.id
        else:
            continue
        if name.isupper() and isinstance(node.ctx, ast.Load):
            uses.append((node, kind, name))
            if name not in kinds.setdefault(kind, []):
                kinds[kind].append(name)
    for node, kind, name in uses:
        names = kinds[kind]
        if len(names) > 1:
            other = names[(names.index(name) + 1) % len(names)]
            yield _replaced(source, node, f"{kind}{other}" if kind.endswith(".") else other)


def _by_entry(source: str) -> Iterator[str]:
    """Entries of dictionaries and tuples of constants left out."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Dict):
            for at in range(len(node.keys)):
                kept = ast.Dict(
                    [key for k, key in enumerate(node.keys) if k != at],
                    [value for k, value in enumerate(node.values) if k != at],
                )
                yield _replaced(source, node, ast.unparse(kept))
        elif isinstance(node, (ast.Set, ast.Tuple)) and len(node.elts) > 1:
            if isinstance(node, ast.Tuple) and not isinstance(node.ctx, ast.Load):
                continue
            for at in range(len(node.elts)):
                rest = [item for k, item in enumerate(node.elts) if k != at]
                kept_items = (
                    ast.Set(rest) if isinstance(node, ast.Set) else ast.Tuple(rest, ast.Load())
                )
                yield _replaced(source, node, ast.unparse(kept_items))


def _replaced(source: str, node: ast.expr, text: str) -> str:
    """The source with a node's text exchanged."""
    lines = source.encode().splitlines(keepends=True)
    assert node.end_lineno is not None
    assert node.end_col_offset is not None
    start = sum(map(len, lines[: node.lineno - 1])) + node.col_offset
    end = sum(map(len, lines[: node.end_lineno - 1])) + node.end_col_offset
    whole = source.encode()
    return (whole[:start] + text.encode() + whole[end:]).decode()


def _meaning(source: str) -> str:
    """What is run: the tree without annotations and docstrings."""

    class Strip(ast.NodeTransformer):
        def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
            node.annotation = ast.Constant("")
            return self.generic_visit(node)

        def visit_arg(self, node: ast.arg) -> ast.AST:
            node.annotation = None
            return node

        def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
            node.returns = None
            return self.generic_visit(node)

        def visit_Expr(self, node: ast.Expr) -> ast.AST:
            return ast.Pass() if isinstance(node.value, ast.Constant) else self.generic_visit(node)

    return ast.dump(Strip().visit(ast.parse(source)))


def _difference(source: str, mutated: str) -> dict[str, object]:
    before, after = source.splitlines(), mutated.splitlines()
    old, new, line = [], [], 0
    for tag, i1, i2, j1, j2 in difflib.SequenceMatcher(
        a=before, b=after, autojunk=False
    ).get_opcodes():
        if tag != "equal":
            line = line or i1 + 1
            old += [text.strip() for text in before[i1:i2]]
            new += [text.strip() for text in after[j1:j2]]
    return {"line": line, "change": f"{' '.join(old)} -> {' '.join(new)}"}
