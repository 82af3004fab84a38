defmodule Aerie.Api.Rest.LinkRequest do
  @moduledoc """
  Reads the body of `POST /api/links`. Pure.

      {"url": "/dev/ttyUSB0,57600", "id": "north", "network": "field", "label": "mast", "high_latency": false}

  Only `url` is required. `MavRouter.Link.start/2` checks the values. A recording is not replayed from here: that would name any
  file of this machine.
  """

  alias Aerie.Base.Json
  alias Aerie.Base.Settings.Types
  alias Aerie.Access.HTTP.{Error, Request}

  @texts ["id", "network", "label", "group"]
  @flags ["high_latency"]
  @keys %{
    "id" => :id,
    "network" => :network,
    "label" => :label,
    "group" => :group,
    "high_latency" => :high_latency
  }
  @max 512

  @doc "Returns the link for `MavRouter.Link.start/2`."
  @spec parse(map()) :: {:ok, map()} | {:error, Error.t()}
  def parse(object) do
    with :ok <- Request.known(object, ["url" | @texts ++ @flags]),
         {:ok, url} <- url(object["url"]),
         {:ok, texts} <- all(@texts, object, &text/2),
         {:ok, flags} <- all(@flags, object, &flag/2),
         do: {:ok, texts |> Map.merge(flags) |> Map.put(:url, url)}
  end

  defp url("replay:" <> _file), do: Error.invalid("a recording is replayed from the command line only")
  defp url(url) when is_binary(url) and byte_size(url) <= @max, do: {:ok, url}

  defp url(_other),
    do: Error.invalid("url must be a connection string such as udpin:0.0.0.0:14550 or /dev/ttyUSB0,57600")

  defp all(keys, object, check) do
    Enum.reduce_while(keys, {:ok, %{}}, fn key, {:ok, values} ->
      case check.(key, object[key]) do
        {:ok, value} -> {:cont, {:ok, Map.put(values, @keys[key], value)}}
        error -> {:halt, error}
      end
    end)
  end

  defp text(_key, nil), do: {:ok, nil}

  defp text("label", text) do
    if Json.text?(text, 0, 256),
      do: {:ok, text},
      else: Error.invalid("label must be a text of at most 256 characters")
  end

  defp text(key, text) do
    with true <- is_binary(text), {:ok, token} <- Types.parse_token(text) do
      {:ok, token}
    else
      _other -> Error.invalid("#{key} must be a name: letters, digits, - and _, 64 at most")
    end
  end

  defp flag(_key, nil), do: {:ok, false}
  defp flag(_key, flag) when is_boolean(flag), do: {:ok, flag}
  defp flag(key, _other), do: Error.invalid("#{key} must be true or false")
end
