"""The wording of pydantic's complaints, about documents and about arguments."""

from numbers import Real

from pydantic import ValidationError

from tulip_testbed.base.errors import InputError, listed, shortened

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
# The same of an argument, which is not written in JSON.
OF_ARGUMENTS = EXPECTED | {
    "bool_type": "True or False",
    "list_type": "a list of them",
    "tuple_type": "a tuple of them",
    "sequence_str": "a list of them",
    "missing": "more values",
    "is_instance_of": "{class}",
}
CLASSES = {"Sequence": "a list of them", "Mapping": "a dictionary", "Path": "a path", "NoneType": "None"}


def validation_message(error: ValidationError) -> str:
    """Describe the first complaint of pydantic in one line, or all missing keys."""
    if missing := missing_keys(error):
        keys = "key" if len(missing) == 1 else "keys"
        return f"{keys} {shortened(listed(map(repr, missing)), 400)}: found nothing"
    return wrong_values(error)[0]


def argument_message(name: str, error: ValidationError) -> str:
    """Describe what was found for an argument, where in it, and what was expected.

    Args:
        error: if the argument may be of several types, that of each; those that went deepest are meant.
    """
    problems = error.errors(include_url=False)
    places = [[part for part in problem["loc"] if isinstance(part, int)] for problem in problems]
    deepest = max(places, key=len)
    meant = [problem for problem, place in zip(problems, places, strict=True) if place == deepest]
    words = [OF_ARGUMENTS.get(one["type"], one["msg"]).format(**one.get("ctx", {})) for one in meant]
    words = list(dict.fromkeys(CLASSES.get(word, word) for word in words))
    expected = f"{', '.join(words[:-1])} or {words[-1]}" if len(words) > 1 else words[0]
    place = "".join(f"[{number}]" for number in deepest)
    return f"{name}{place}: found {_found(meant[0]['input'])}, expected {expected}"


def _found(value: object) -> str:
    """Name the type of a value, and the value itself if it is short."""
    if value is None:
        return "None"
    name = type(value).__name__
    return f"the {name} {shortened(repr(value), 40)}" if isinstance(value, str | Real) else name


def missing_keys(error: ValidationError) -> list[str]:
    """List the paths of the keys that are missing, with dots."""
    return [_place(problem["loc"]) for problem in error.errors() if problem["type"] == "missing"]


def wrong_values(error: ValidationError) -> list[str]:
    """Describe every value that is not what was expected."""
    texts = []
    for problem in error.errors():
        if isinstance(problem.get("ctx", {}).get("error"), InputError):  # of a value that reads itself
            texts.append(f"key '{_place(problem['loc'])}': {problem['ctx']['error']}")
        elif problem["type"] != "missing":
            words = EXPECTED.get(problem["type"], problem["msg"]).format(**problem.get("ctx", {}))
            expected = shortened(words.removeprefix("expected "), 200)
            found = shortened(repr(problem["input"]))
            texts.append(f"key '{_place(problem['loc'])}': found {found}; expected {expected}")
    return texts


def _place(parts: tuple[int | str, ...]) -> str:
    return shortened(".".join(map(str, parts)))
