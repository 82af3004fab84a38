defmodule Aerie.Router.Echo do
  @moduledoc """
  Frames with our own ids that come to us. They are echoes, as a loop between routers brings them, and are dropped; but what
  we say is never an autopilot's heartbeat. One with our ids is a vehicle that has them too and is not seen for that: told in
  the log, and to whoever asks (`alarm/1`) until it was silent for ten seconds.
  """

  alias Aerie.Names
  alias Aerie.Mavlink.Heartbeat
  alias Aerie.Router.Plan.Way
  alias Aerie.Router.Tables
  alias MavCodec.Frame

  require Logger

  @silent_ms 10_000

  @doc "Looks at frames with our own ids."
  @spec look(Tables.t(), Way.t(), [Frame.t()], now :: integer) :: :ok
  def look(tables, way, frames, now) do
    with %Frame{} = frame <- Enum.find(frames, &vehicle?/1) do
      alarm = %{system: frame.system, component: frame.component, link: way.owner}
      if current(tables, now) == nil, do: Logger.error(words(alarm))
      :ets.insert(tables.settings, {:taken, now, alarm})
    end

    :ok
  end

  defp vehicle?(%Frame{id: 0, crc_extra: extra} = frame) when extra != nil,
    do: frame |> Heartbeat.read() |> Heartbeat.vehicle?()

  defp vehicle?(_frame), do: false

  defp current(tables, now) do
    case :ets.lookup(tables.settings, :taken) do
      [{:taken, at, alarm}] when now - at < @silent_ms -> alarm
      _none -> nil
    end
  end

  @doc "That an autopilot is heard that has our ids, in words; nil when there is none."
  @spec alarm(Names.gateway()) :: String.t() | nil
  def alarm(gateway) do
    with tables when is_map(tables) <- Tables.of(gateway),
         %{} = alarm <- current(tables, System.monotonic_time(:millisecond)),
         do: words(alarm)
  end

  defp words(%{system: system, component: component, link: link}) do
    "an autopilot on #{link} is system #{system}, component #{component}, which this gateway is too: nothing of that vehicle " <>
      "is taken in. Give mavlink.component_id (191 is the on-board computer), or mavlink.system_id at a hub, another value."
  end
end
