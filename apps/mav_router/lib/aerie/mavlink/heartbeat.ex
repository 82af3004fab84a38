defmodule Aerie.Mavlink.Heartbeat do
  @moduledoc """
  What a HEARTBEAT says about its sender, read straight from the payload: the router looks at no other message.

  A vehicle is known by its autopilot (H2: the field `autopilot`, never the component id, R10). Some ground stations and
  payloads fill that field in as well, so their types are no vehicles either.
  """

  alias MavCodec.Frame

  @id 0
  @high_latency2 235
  @autopilot_invalid 8

  # MAV_TYPE of everything that is a part of a vehicle or no vehicle at all.
  @not_vehicles %{
    6 => "gcs",
    18 => "onboard_controller",
    26 => "gimbal",
    27 => "adsb",
    30 => "camera",
    31 => "charging_station",
    32 => "flarm",
    33 => "servo",
    34 => "odid",
    36 => "battery",
    37 => "parachute",
    38 => "log",
    39 => "osd",
    40 => "imu",
    41 => "gps",
    42 => "winch"
  }

  @enforce_keys [:type, :autopilot]
  defstruct [:type, :autopilot]

  @typedoc "`type`: MAV_TYPE, `autopilot`: MAV_AUTOPILOT, both as numbers: unknown values survive"
  @type t :: %__MODULE__{type: 0..255, autopilot: 0..255}

  @doc "The message id of HEARTBEAT."
  @spec id() :: 0
  def id, do: @id

  @doc "Reads a frame, HIGH_LATENCY2 as well; nil when it is neither. Bytes that were cut off are zeros (F7)."
  @spec read(Frame.t()) :: t | nil
  def read(%Frame{id: @id, payload: <<_custom_mode::32, type, autopilot, _::binary>>}) do
    %__MODULE__{type: type, autopilot: autopilot}
  end

  def read(%Frame{id: @high_latency2, payload: <<_values::24-binary, type, autopilot, _::binary>>}),
    do: %__MODULE__{type: type, autopilot: autopilot}

  def read(%Frame{id: id, payload: payload} = frame) when id in [@id, @high_latency2],
    do: read(%{frame | payload: payload <> <<0::size(26 - byte_size(payload))-unit(8)>>})

  def read(%Frame{}), do: nil

  @doc "Whether the sender is the autopilot of a vehicle."
  @spec vehicle?(t) :: boolean
  def vehicle?(%__MODULE__{autopilot: @autopilot_invalid}), do: false
  def vehicle?(%__MODULE__{type: type}), do: not is_map_key(@not_vehicles, type)

  @doc "What a sender that is no vehicle is, in a word; `component` for what has no name here."
  @spec role(t) :: String.t()
  def role(%__MODULE__{type: type} = heartbeat) do
    if vehicle?(heartbeat), do: "autopilot", else: Map.get(@not_vehicles, type, "component")
  end
end
