"""The body of a chat completion request."""

from __future__ import annotations

import json
from collections.abc import Collection
from typing import Any

from envcraft_llm.model import Request


def request_body(request: Request, unsupported: Collection[str] = (), stream: bool = True) -> dict[str, Any]:
    """Return the JSON body of a request.

    Args:
        request: The request.
        unsupported: Parameters that the endpoint does not support. Effort and schema move into the messages; the
            others are left out.
        stream: Whether the response is an event stream.
    """
    messages: list[dict[str, str]] = [
        {"role": message.role, "content": message.content} for message in request.messages
    ]
    body: dict[str, Any] = {"model": request.model, "messages": messages}
    if stream:
        body["stream"] = True
    if stream and "stream_options" not in unsupported:
        body["stream_options"] = {"include_usage": True}
    if request.max_tokens:
        body["max_completion_tokens" if "max_tokens" in unsupported else "max_tokens"] = request.max_tokens
    if request.temperature is not None and "temperature" not in unsupported:
        body["temperature"] = request.temperature
    if request.effort and "reasoning_effort" not in unsupported:
        body["reasoning_effort"] = request.effort
    elif request.effort:
        # gpt-oss reads its effort from the system message.
        if messages[0]["role"] != "system":
            messages.insert(0, {"role": "system", "content": ""})
        messages[0]["content"] = f"Reasoning: {request.effort}\n\n{messages[0]['content']}".strip()
    if request.schema is not None and "response_format" not in unsupported:
        named = {"name": "answer", "schema": request.schema, "strict": True}
        body["response_format"] = {"type": "json_schema", "json_schema": named}
    elif request.schema is not None:
        schema = json.dumps(request.schema)
        messages[-1]["content"] += f"\n\nAnswer with one JSON object alone. It follows this JSON Schema:\n{schema}"
    return body
