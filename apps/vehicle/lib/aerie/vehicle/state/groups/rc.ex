defmodule Aerie.Vehicle.State.Groups.Rc do
  @moduledoc "The remote control."

  alias Aerie.Vehicle.Firmware
  alias Aerie.Vehicle.State.{Group, Value}
  alias MavCodec.Messages, as: M

  @channels for n <- 1..18, do: :"chan#{n}_raw"

  use Group,
    name: :rc,
    title: "The remote control.",
    sampling: {:time, 0.2, %{}, 60.0},
    messages: [M.RcChannels, {M.RcChannelsRaw, M.RcChannels}],
    fields: [
      {:channels, {:list, 0}, "µs", "a list of pulse widths, null for an unused channel",
       "RC_CHANNELS, RC_CHANNELS_RAW"},
      {:rssi, 2, "0..1", "signal strength; PX4 sends percent, others 0 to 254",
       "RC_CHANNELS, RC_CHANNELS_RAW"}
    ]

  @impl Group
  def read(%M.RcChannels{} = m, state, _at), do: channels(m, Enum.take(@channels, m.chancount), state)
  def read(%M.RcChannelsRaw{port: 0} = m, state, _at), do: channels(m, Enum.take(@channels, 8), state)
  # RC_CHANNELS also has the other ports.
  def read(%M.RcChannelsRaw{}, _state, _at), do: {[], []}

  defp channels(m, names, state) do
    channels = for name <- names, do: channel(Map.fetch!(m, name))
    full = Firmware.telemetry(state.autopilot).rssi_full
    {[], rc: %{channels: channels, rssi: Value.up_to(m.rssi, full, full)}}
  end

  defp channel(0), do: nil
  defp channel(0xFFFF), do: nil
  defp channel(microseconds), do: microseconds
end
