"""A request as the interface has it."""

from __future__ import annotations

import json
from collections.abc import Collection
from typing import Any

from envcraft_llm.model import Request


def body(request: Request, refused: Collection[str] = (), stream: bool = True) -> dict[str, Any]:
    """The parameters of a request. Those that are `refused` are said in words, where words can."""
    messages: list[dict[str, str]] = [
        {"role": message.role, "content": message.content} for message in request.messages
    ]
    told: dict[str, Any] = {"model": request.model, "messages": messages}
    if stream:
        told["stream"] = True
    if stream and "stream_options" not in refused:
        told["stream_options"] = {"include_usage": True}
    if request.max_tokens:
        told["max_completion_tokens" if "max_tokens" in refused else "max_tokens"] = request.max_tokens
    if request.temperature is not None and "temperature" not in refused:
        told["temperature"] = request.temperature
    if request.effort and "reasoning_effort" not in refused:
        told["reasoning_effort"] = request.effort
    elif request.effort:
        # How gpt-oss is told where nothing else does it.
        if messages[0]["role"] != "system":
            messages.insert(0, {"role": "system", "content": ""})
        messages[0]["content"] = f"Reasoning: {request.effort}\n\n{messages[0]['content']}".strip()
    if request.schema is not None and "response_format" not in refused:
        named = {"name": "answer", "schema": request.schema, "strict": True}
        told["response_format"] = {"type": "json_schema", "json_schema": named}
    elif request.schema is not None:
        schema = json.dumps(request.schema)
        messages[-1]["content"] += f"\n\nAnswer with one JSON object alone. It follows this JSON Schema:\n{schema}"
    return told
