defmodule MavRouter.Router.Echo do
  @moduledoc """
  Frames that carry the gateway's own ids. They are echoes, brought back by a loop between routers, and are dropped. An
  autopilot's heartbeat is not an echo, because the gateway sends none: it means that a vehicle has the same ids and is therefore
  not seen. The log says so, and `alarm/1`, until that vehicle has been silent for ten seconds. On a link with keys only a signed
  one says so, because a sender without a key could otherwise keep the gateway from being ready.
  """

  alias MavCodec.Meaning.Heartbeat
  alias MavCodec.MessageId
  alias Aerie.Base.Names
  alias MavRouter.Forward.Delivery
  alias MavRouter.Tables
  alias MavCodec.Frame

  require Logger

  @heartbeat MessageId.of!("HEARTBEAT")
  @silent_ms 10_000

  @doc "Looks at frames with our own ids that are trusted (`MavRouter.Signing.admit/3`)."
  @spec check(Delivery.t(), [Frame.t()]) :: :ok
  def check(%{tables: tables, path: path, now: now}, frames) do
    with %Frame{} = frame <- Enum.find(frames, &vehicle?/1) do
      alarm = %{system: frame.system, component: frame.component, link: path.owner}
      if current(tables, now) == nil, do: Logger.error(text(alarm))
      :ets.insert(tables.settings, {:own_ids_heard, now, alarm})
    end

    :ok
  end

  defp vehicle?(%Frame{id: @heartbeat, crc_extra: extra} = frame) when extra != nil,
    do: frame |> Heartbeat.read() |> Heartbeat.vehicle?()

  defp vehicle?(_frame), do: false

  defp current(tables, now) do
    case :ets.lookup(tables.settings, :own_ids_heard) do
      [{:own_ids_heard, at, alarm}] when now - at < @silent_ms -> alarm
      _none -> nil
    end
  end

  @doc "The alarm of an autopilot that has the gateway's own ids, for people; nil when there is none."
  @spec alarm(Names.gateway()) :: String.t() | nil
  def alarm(gateway) do
    with tables when is_map(tables) <- Tables.of(gateway),
         %{} = alarm <- current(tables, System.monotonic_time(:millisecond)),
         do: text(alarm)
  end

  defp text(%{system: system, component: component, link: link}) do
    "an autopilot on #{link} is system #{system}, component #{component}, which are this gateway's own ids: nothing of that " <>
      "vehicle is taken in. Give mavlink.component_id another value (191 is the on-board computer), or mavlink.system_id at a hub."
  end
end
