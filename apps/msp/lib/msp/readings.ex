defmodule Msp.Readings do
  @moduledoc """
  What a flight controller is asked by itself, what its replies say, and the MAVLink messages that are made of that.
  There is a module for each subject; to add a message of MSP, add it to one.

  Readings have one form for both firmwares: SI units, pitch positive with the nose up, and no value where the firmware
  sends a stand-in for an unknown one. A message is made when a reply brought what is in it, never from memory alone, so
  that its age is that of the reply. What is not known has MAVLink's value for that.
  """

  alias Msp.{Mission, Modes}
  alias Msp.Readings.{Attitude, Battery, Navigation, Position, Receiver, Status}

  @subjects [Status, Attitude, Position, Battery, Receiver, Navigation]
  # Its bit in the sensors of both firmwares; GPS_FIX_TYPE.
  @baro 1
  @fix_3d 3

  @typedoc """
  - `boxes`: permanent ids of the boxes that are on, nil while BOXIDS is not known; `boxes_at`: when it said so;
    `arming`: the arming flags; `sensors`: the sensors' bits
  - `load`: 0..1
  - `roll`, `pitch`, `yaw`: degrees; `climb`: m/s
  - `alt_rel`: m above home, nil if that is not known, `alt_at`: when it was read; `alt_last`: the last one, and when;
    `alt_local`: m above iNav's origin
  - `fix`: GPS_FIX_TYPE; `satellites`; `lat`, `lon`: degrees; `alt_msl`: m; `speed`: m/s; `course`: degrees; `dilution`
  - `voltage`: V; `current`: A; `drawn`: mAh; `cells`; `remaining`: 0..1; `charge`: `:ok | :low | :critical | :absent`
  - `rssi`: 0..1; `channels`: µs in the order of the receiver (AETR)
  - `nav_mode`, `waypoint`: what iNav's navigation does (NAV_STATUS); `waypoints`: of its mission
  - `home`: `{lat, lon, alt_msl}` of iNav, nil without one; `here_msl`: how high it is itself; `origin_msl`: above what
    its ALTITUDE is; `on_s`: its seconds since its start
  - `unhealthy`: bits of `sensors` that do not work
  """
  @type t :: %{optional(atom) => term}

  @typedoc """
  A message that is asked: its name and arguments, how often (ms) by firmware, and which of the messages made of its
  reply have a rate that clients set; it is asked as often as the most wanted of them.
  """
  @type poll :: {String.t(), map, [{Modes.firmware(), pos_integer}], rated :: [module]}

  @typedoc "`boot_us`, `boot_ms`: time since the vehicle's start; `aboard`: its mission, if it was read."
  @type context :: %{
          boot_us: integer,
          boot_ms: 0..0xFFFFFFFF,
          aboard: %{waypoints: [Mission.waypoint()], items: [struct]} | nil
        }

  @doc "What is asked about the subject."
  @callback polls() :: [poll]

  @doc "What a reply says; nothing for one that is cut short or says nothing about the subject."
  @callback read(Modes.firmware(), name :: String.t(), MavCodec.Msp.Payload.values(), ids :: [byte]) :: t

  @doc "The messages that are made when this was read."
  @callback messages(name :: String.t(), t, context) :: [struct]

  @doc "All that is asked."
  @spec polls() :: [poll]
  def polls, do: Enum.flat_map(@subjects, & &1.polls())

  @doc "What a reply says; `ids` is the vehicle's BOXIDS."
  @spec read(Modes.firmware(), name :: String.t(), MavCodec.Msp.Payload.values(), ids :: [byte]) :: t
  def read(firmware, name, values, ids) do
    case subject(name) do
      nil -> %{}
      subject -> subject.read(firmware, name, values, ids)
    end
  end

  @doc "The messages that are made when this was read."
  @spec messages(name :: String.t(), t, context) :: [struct]
  def messages(name, readings, context), do: subject(name).messages(name, readings, context)

  defp subject(name), do: Enum.find(@subjects, &List.keymember?(&1.polls(), name, 0))

  @doc "Whether it has a barometer that works, by which it knows how high it is."
  @spec barometer?(t) :: boolean
  def barometer?(readings), do: bit?(readings[:sensors], @baro) and not bit?(readings[:unhealthy], @baro)

  @doc "Whether it measures heights: without a barometer by its position. If not it says 0, however high it is."
  @spec altimeter?(t) :: boolean
  def altimeter?(readings), do: barometer?(readings) or (readings[:fix] || 0) >= @fix_3d

  defp bit?(bits, bit), do: Bitwise.band(Bitwise.bsr(bits || 0, bit), 1) == 1
end
