"""The wording of pydantic's complaints."""

from __future__ import annotations

from pydantic import ValidationError

from tulip_testbed.base.errors import listed, shortened

# What is expected, by pydantic's type of complaint; in braces what it says of it.
EXPECTED = {
    "float_type": "a number",
    "finite_number": "a finite number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "string_type": "a text",
    "bool_type": "true or false",
    "list_type": "a list",
    "tuple_type": "a list",
    "dict_type": "an object",
    "model_type": "an object",
    "literal_error": "{expected}",
    "greater_than": "more than {gt:g}",
    "greater_than_equal": "{ge:g} or more",
    "less_than": "less than {lt:g}",
    "less_than_equal": "{le:g} or less",
    "too_short": "{min_length} or more values",
    "too_long": "at most {max_length} values",
    "extra_forbidden": "no such key",
    "union_tag_invalid": "key {discriminator} to be one of {expected_tags}",
    "union_tag_not_found": "a key {discriminator}",
    "value_error": "{error}",
}


def validation_message(error: ValidationError) -> str:
    """Describe the first complaint of pydantic in one line, or all missing keys."""
    if missing := missing_keys(error):
        keys = "key" if len(missing) == 1 else "keys"
        return f"{keys} {shortened(listed(map(repr, missing)), 400)}: found nothing"
    return wrong_values(error)[0]


def missing_keys(error: ValidationError) -> list[str]:
    """List the paths of the keys that are missing, with dots."""
    return [_place(problem["loc"]) for problem in error.errors() if problem["type"] == "missing"]


def wrong_values(error: ValidationError) -> list[str]:
    """Describe every value that is not what was expected."""
    texts = []
    for problem in error.errors():
        if problem["type"] != "missing":
            words = EXPECTED.get(problem["type"], problem["msg"]).format(**problem.get("ctx", {}))
            expected = shortened(words.removeprefix("expected "), 200)
            found = shortened(repr(problem["input"]))
            texts.append(f"key '{_place(problem['loc'])}': found {found}; expected {expected}")
    return texts


def _place(parts: tuple[int | str, ...]) -> str:
    return shortened(".".join(map(str, parts)))
