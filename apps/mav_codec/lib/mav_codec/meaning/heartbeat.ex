defmodule MavCodec.Meaning.Heartbeat do
  @moduledoc """
  What a HEARTBEAT or HIGH_LATENCY2 says about its sender, read straight from the payload.

  A vehicle is recognised by the field `autopilot` (H2), not by the component id (R10). Some ground stations and payloads set that
  field as well, so their types are not vehicles either. Where neither says anything (both GENERIC, as a Herelink's air unit sends, 42/250),
  only the component of an autopilot is one.
  """

  alias MavCodec.MessageId
  alias MavCodec.Enums.{MavAutopilot, MavComponent, MavType}
  alias MavCodec.Frame

  @id MessageId.of!("HEARTBEAT")
  @high_latency2 MessageId.of!("HIGH_LATENCY2")
  @gcs MavType.value(:MAV_TYPE_GCS)
  @autopilot_invalid MavAutopilot.value(:MAV_AUTOPILOT_INVALID)

  # Every MAV_TYPE that is a part of a vehicle or no vehicle at all.
  @parts ~w(GCS ONBOARD_CONTROLLER GIMBAL ADSB CAMERA CHARGING_STATION FLARM SERVO ODID BATTERY PARACHUTE LOG OSD IMU GPS WINCH
            ILLUMINATOR)
  @not_vehicles for name <- @parts,
                    into: %{},
                    do: {MavType.value(:"MAV_TYPE_#{name}"), String.downcase(name)}

  @generic_type MavType.value(:MAV_TYPE_GENERIC)
  @generic MavAutopilot.value(:MAV_AUTOPILOT_GENERIC)
  @autopilot1 MavComponent.value(:MAV_COMP_ID_AUTOPILOT1)

  @enforce_keys [:type, :autopilot]
  defstruct [:type, :autopilot, component: 0]

  @typedoc "`type`: MAV_TYPE, `autopilot`: MAV_AUTOPILOT, both as numbers: unknown values survive; `component`: the sender's id, 0 if it is not asked for"
  @type t :: %__MODULE__{type: 0..255, autopilot: 0..255, component: 0..255}

  @doc "Whether a system id is a ground station's by convention. ArduPilot takes any heartbeat from its SYSID_MYGCS for its operator's."
  defguard is_station(system) when system >= 240

  @doc "The message id of HEARTBEAT."
  @spec id() :: non_neg_integer
  def id, do: @id

  @doc "Reads a HEARTBEAT or HIGH_LATENCY2; nil for any other frame. Bytes that were cut off are zeros (F7)."
  @spec read(Frame.t()) :: t | nil
  def read(%Frame{id: @id, payload: <<_custom_mode::32, type, autopilot, _::binary>>} = frame) do
    %__MODULE__{type: type, autopilot: autopilot, component: frame.component}
  end

  def read(%Frame{id: @high_latency2, payload: <<_values::24-binary, type, autopilot, _::binary>>} = frame),
    do: %__MODULE__{type: type, autopilot: autopilot, component: frame.component}

  def read(%Frame{id: id, payload: payload} = frame) when id in [@id, @high_latency2],
    do: read(%{frame | payload: payload <> <<0::size(26 - byte_size(payload))-unit(8)>>})

  def read(%Frame{}), do: nil

  @doc "Whether the sender is the autopilot of a vehicle."
  @spec vehicle?(t) :: boolean
  def vehicle?(%__MODULE__{autopilot: @autopilot_invalid}), do: false

  def vehicle?(%__MODULE__{autopilot: @generic, type: @generic_type, component: component}),
    do: component in [0, @autopilot1]

  def vehicle?(%__MODULE__{type: type}), do: not is_map_key(@not_vehicles, type)

  @doc "Whether a vehicle may take the sender of a frame for its operator's ground station, and a failsafe stays quiet because of it."
  @spec station?(Frame.t()) :: boolean
  def station?(%Frame{system: system}) when is_station(system), do: true
  def station?(%Frame{} = frame), do: match?(%__MODULE__{type: @gcs}, read(frame))

  @doc "What the sender is, in a word: `autopilot`, `gcs`, `gimbal` …; `component` if nothing else is known."
  @spec role(t) :: String.t()
  def role(%__MODULE__{type: type} = heartbeat) do
    if vehicle?(heartbeat), do: "autopilot", else: Map.get(@not_vehicles, type, "component")
  end
end
