"""Mutants of a source text, with one fault each.

`cosmic-ray` changes operators, numbers and conditions. Tables are changed here: entries are removed one by one,
and constants are replaced by the next one of their kind.
"""

import ast
import copy
import difflib
from collections.abc import Iterator
from dataclasses import dataclass

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.operators.provider import OperatorProvider


@dataclass(frozen=True, slots=True, kw_only=True)
class Mutant:
    """A module with one change: `change` has its lines before and after."""

    line: int
    change: str
    source: str


def mutants_of(source: str) -> Iterator[Mutant]:
    """Yield mutants that may behave differently, by code without annotations and docstrings."""
    known = {_code(source)}
    for mutated in (*_by_operator(source), *_by_name(source), *_by_entry(source)):
        try:
            code = _code(mutated)
        except SyntaxError:
            continue
        if code not in known:
            known.add(code)
            yield Mutant(**_difference(source, mutated), source=mutated)


def _by_operator(source: str) -> Iterator[str]:
    provider = OperatorProvider()
    tree = get_ast(source)
    for name in provider:
        # Members of an enumeration are one object each: `is` and `==` agree.
        if name.endswith(("Is_Eq", "IsNot_NotEq")) or provider[name].arguments():
            continue
        operator = provider[name]()
        places = sum(1 for node in ast_nodes(tree) for _ in operator.mutation_positions(node))
        for place in range(places):
            mutated = mutate_code(source, operator, place)
            if mutated is not None:
                yield mutated


def _by_name(source: str) -> Iterator[str]:
    """Replace constants: `_S.FAULT` by the next name used with `_S`, CONTROLWORD_X by the next."""
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
    """Remove one entry of a dictionary, or of a set or tuple of several."""
    for node in ast.walk(ast.parse(source)):
        lists = ("keys", "values") if isinstance(node, ast.Dict) else ("elts",)
        of_several = isinstance(node, (ast.Set, ast.Tuple)) and len(node.elts) > 1
        is_target = not isinstance(getattr(node, "ctx", ast.Load()), ast.Load)
        if is_target or not (of_several or isinstance(node, ast.Dict)):
            continue
        for at in range(len(getattr(node, lists[0]))):
            shorter = copy.deepcopy(node)
            for name in lists:
                del getattr(shorter, name)[at]
            yield _replaced(source, node, ast.unparse(shorter))


def _replaced(source: str, node: ast.expr, text: str) -> str:
    """Return the source with another text of a node."""
    encoded = source.encode()
    lines = encoded.splitlines(keepends=True)
    assert node.end_lineno is not None
    assert node.end_col_offset is not None
    start = sum(map(len, lines[: node.lineno - 1])) + node.col_offset
    end = sum(map(len, lines[: node.end_lineno - 1])) + node.end_col_offset
    return (encoded[:start] + text.encode() + encoded[end:]).decode()


def _code(source: str) -> str:
    """Return the syntax tree without annotations and docstrings."""

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
