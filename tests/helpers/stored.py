"""Stored files as somebody else may write them."""

import hashlib
import json
from typing import Any


def sealed(data: dict[str, Any]) -> str:
    """A file of these data, the schema among them, with the digest that belongs to them."""
    counted = {name: each for name, each in data.items() if name not in ("schema", "digest")}
    text = json.dumps(counted, sort_keys=True, separators=(",", ":"))
    return json.dumps(data | {"digest": hashlib.sha256(text.encode()).hexdigest()})
