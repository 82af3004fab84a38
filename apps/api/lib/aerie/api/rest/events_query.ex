defmodule Aerie.Api.Rest.EventsQuery do
  @moduledoc """
  Checks the query of `GET /api/events` and `GET /api/vehicles/ID/events`. Pure.

      ?limit=100&since=2026-11-22T10:15:00Z

  `limit` is 1 to 1000, by default 100; `since` is a time, ISO 8601 with its offset or unix seconds.
  """

  alias Aerie.Access.HTTP.Error

  @most 1000
  # The end of year 9999, the last one that ISO 8601 writes with four digits.
  @last_s 253_402_300_799

  @type options :: [limit: pos_integer(), since: integer() | nil]

  @doc "Returns the options for `Aerie.Vehicle.Events.Journal.recent/3`."
  @spec parse(%{String.t() => String.t() | nil}) :: {:ok, options()} | {:error, Error.t()}
  def parse(parameters) do
    with :ok <- known(Map.keys(parameters) -- ["limit", "since"]),
         {:ok, limit} <- limit(Map.get(parameters, "limit", "100")),
         {:ok, since} <- since(Map.get(parameters, "since", :none)) do
      {:ok, limit: limit, since: since}
    end
  end

  defp known([]), do: :ok
  defp known(_others), do: bad("unknown parameter; the parameters are limit and since")

  defp limit(text) do
    case Integer.parse(text || "") do
      {n, ""} when n in 1..@most -> {:ok, n}
      _other -> bad("limit must be a number from 1 to #{@most}")
    end
  end

  defp since(:none), do: {:ok, nil}

  defp since(text) do
    with {:error, _no_date} <- DateTime.from_iso8601(text || ""),
         {seconds, ""} when seconds >= 0 and seconds <= @last_s <- Float.parse(text || "") do
      {:ok, round(seconds * 1_000_000)}
    else
      {:ok, time, _offset} -> {:ok, DateTime.to_unix(time, :microsecond)}
      _neither -> bad("since must be a time such as 2026-11-22T10:15:00Z, or unix seconds")
    end
  end

  defp bad(words), do: {:error, Error.new(:bad_request, words)}
end
