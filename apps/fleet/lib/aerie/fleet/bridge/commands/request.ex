defmodule Aerie.Fleet.Bridge.Commands.Request do
  @moduledoc """
  A message on `fleet.{environment}.{vehicle}.cmd.{type}` as a command: who commands, and the envelope. Pure. A
  message of another area (`Aerie.Fleet.Bridge.Commands.Operation`) is read alike; its type is `{area}.{operation}`.

  Body and headers:

      {"id": "a1", "params": {"altitude": 20}, "deadline": "2026-11-22T09:00:10Z", "source": "tablet 3"}

      Aerie-Signature: see Aerie.Control.Policy.Roles.Signature
      Aerie-Deadline, Aerie-Source: in place of the keys of the body

  Headers are not signed, so those of a signed command are ignored: its deadline is in its body.
  """

  alias Aerie.Fleet.Bridge.Commands.Operation
  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.Roles
  alias Aerie.Control.Policy.Roles.Sources
  alias Aerie.Vehicle.Command.Refusal

  @max_bytes 16_384

  @type t :: %{vehicle: String.t(), type: String.t(), envelope: map(), source: Roles.source()}

  @doc "Vehicle and type of a subject."
  @spec subject(String.t()) :: {vehicle :: String.t(), type :: String.t()}
  def subject(topic) do
    case String.split(topic, ".") do
      ["fleet", _environment, vehicle, "cmd", type] -> {vehicle, type}
      ["fleet", _environment, vehicle, area, operation] -> {vehicle, area <> "." <> operation}
    end
  end

  @doc "The header `Aerie-Signature` of a message; nil without one."
  @spec signature(Aerie.Fleet.Nats.message()) :: String.t() | nil
  def signature(message) do
    case List.keyfind(message[:headers] || [], "aerie-signature", 0) do
      {_name, text} -> text
      nil -> nil
    end
  end

  @doc "Reads a message at `now` (unix microseconds). A refusal comes with what could be read of the envelope."
  @spec read(Aerie.Fleet.Nats.message(), Policy.t() | nil, now :: integer()) ::
          {:ok, t()} | {:refused, map(), Refusal.denial()}
  def read(%{topic: topic, body: body} = message, policy, now) do
    {vehicle, type} = subject(topic)
    headers = Map.new(message[:headers] || [])
    named = %{"vehicle" => vehicle, "type" => type}

    # The signature first: a forged body is not even parsed, but for its id.
    with {:size, :ok} <- {:size, short(body, max_bytes(type))},
         {:who, {:ok, source}} <- {:who, Sources.identify(policy, signature(message), topic, body, now)},
         {:object, {:ok, given}} <- {:object, decode(body, max_bytes(type))},
         named = Map.merge(given, named),
         {:ok, envelope} <- envelope(given, named, headers) do
      {:ok, %{vehicle: vehicle, type: type, envelope: envelope, source: source}}
    else
      {:who, denial} -> {:refused, Map.merge(id(body), named), denial}
      {_unread, denial} -> {:refused, named, denial}
      refused -> refused
    end
  end

  defp id(body) do
    case decode(body, @max_bytes) do
      {:ok, given} -> Map.take(given, ["id"])
      _unreadable -> %{}
    end
  end

  # No command has a dot in its name.
  defp max_bytes(type), do: if(String.contains?(type, "."), do: Operation.max_bytes(), else: @max_bytes)

  defp short(body, max) when byte_size(body) > max, do: Refusal.deny(:body_large, most: max)
  defp short(_body, _max), do: :ok

  @doc "The object that a body of at most `max` bytes is."
  @spec decode(binary(), max :: pos_integer()) :: {:ok, map()} | Refusal.denial()
  def decode(body, max) do
    with :ok <- short(body, max),
         {:ok, %{} = object} <- JSON.decode(body) do
      {:ok, object}
    else
      {:deny, :size, _reason} = denial -> denial
      _other -> Refusal.deny(:no_object)
    end
  end

  defp envelope(given, named, headers) do
    other = for key <- ["vehicle", "type"], given[key] not in [nil, named[key]], do: key

    cond do
      other != [] ->
        {:refused, named, Refusal.deny(:another_subject, key: hd(other))}

      headers["aerie-signature"] != nil and headers["aerie-deadline"] != nil ->
        {:refused, named, Refusal.deny(:deadline_unsigned)}

      true ->
        # Every command needs an id of the sender: without one a copy of it would be another command.
        {:ok,
         named
         |> Map.put_new("id", nil)
         |> header("deadline", headers["aerie-deadline"])
         |> header("source", headers["aerie-source"])}
    end
  end

  defp header(envelope, _key, nil), do: envelope
  defp header(envelope, key, _value) when is_map_key(envelope, key), do: envelope
  defp header(envelope, "deadline", text), do: Map.put(envelope, "deadline", number(text))
  defp header(envelope, key, text), do: Map.put(envelope, key, text)

  # Unix seconds are text in a header.
  defp number(text) do
    case Float.parse(text) do
      {seconds, ""} -> seconds
      _time -> text
    end
  end
end
