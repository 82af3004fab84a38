defmodule Aerie.Console.Clock do
  @moduledoc """
  The console's one clock: UTC, 24 hours. Every time that a page writes comes from here, charts draw the same (`assets/lib/clock.js`), and the
  header of every page shows the present time with the zone's name.

  It is UTC and not the browser's zone, because the vehicles' logs, the audit log, NATS and the HTTP API use UTC, and operators in different
  places have to mean the same moment.
  """

  @zone "UTC"

  @typedoc "Unix microseconds, or ISO 8601 in UTC as the read model has it."
  @type moment :: integer() | String.t()

  @doc "The name of the zone."
  @spec zone() :: String.t()
  def zone, do: @zone

  @doc "The time of day, `14:39:05`, for lists below a header that names the zone."
  @spec time(moment()) :: String.t()
  def time(moment), do: moment |> iso() |> String.slice(11, 8)

  @doc "Date and time, `2026-11-27 14:39:05`, for lists."
  @spec stamp(moment() | nil) :: String.t()
  def stamp(nil), do: "–"
  def stamp(moment), do: moment |> iso() |> String.slice(0, 19) |> String.replace("T", " ")

  @doc "Date, time and zone, `2026-11-27 14:39:05 UTC`, for sentences."
  @spec full(moment() | nil) :: String.t()
  def full(nil), do: "–"
  def full(moment), do: "#{stamp(moment)} #{@zone}"

  @doc "The minute with the zone, `14:39 UTC`, for sentences and the header."
  @spec minute(moment()) :: String.t()
  def minute(moment), do: "#{moment |> iso() |> String.slice(11, 5)} #{@zone}"

  @doc "The whole moment, for a machine or a tooltip: `2026-11-27T14:39:05.123Z`."
  @spec iso(moment()) :: String.t()
  def iso(us) when is_integer(us), do: "#{Aerie.Base.Json.time(us)}"
  def iso(text) when is_binary(text), do: text
end
