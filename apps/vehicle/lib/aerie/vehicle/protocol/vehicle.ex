defmodule Aerie.Vehicle.Protocol.Vehicle do
  @moduledoc """
  What an adapter and the executor know about the vehicle that they command: its address and its observed state. A plain
  value that the owner of the state fills in. nil means "not known".
  """

  alias Aerie.Vehicle.Command.Refusal

  @enforce_keys [:system, :autopilot, :kind]
  defstruct [
    :system,
    :autopilot,
    :kind,
    :mode,
    :armed,
    :in_air,
    :vtol_state,
    :lat,
    :lon,
    :alt_msl,
    :alt_rel,
    :heading,
    :home,
    :mission_seq,
    :booted_at,
    :busy_with,
    :gcs,
    :gimbal_manager,
    component: 1,
    version: 2,
    params: %{},
    us: {237, 191},
    mode_names: %{},
    standard_modes: %{},
    arming_checks: [],
    boots: 0,
    seen: %{}
  ]

  @typedoc "Values that one message reports together."
  @type group :: :mode | :in_air | :vtol | :position | :home | :mission

  @typedoc """
    * `:kind` - as `Aerie.Vehicle.Protocol.Kind.name/1` says: copter, plane, vtol, rover, boat, sub …
    * `:version` - that of MAVLink which it speaks
    * `:us` - system and component that commands are sent from
    * `:mode_names` - number to name, of modes that the vehicle itself named (X4)
    * `:standard_modes` - the numbers of its modes for MAVLink's standard modes, if it reported them (X4)
    * `:arming_checks` - names of the checks that keep it from being armed, if it reports them (PX4)
    * heights in metres, `:heading` in degrees from north; `:home` with `lat`, `lon`, `alt_msl`
    * `:gcs` - lowest and highest system id of the ground stations that ArduPilot obeys; `:params` - `Aerie.Vehicle.Services.Switches`
    * `:gimbal_manager` - the component that says that it manages the gimbals
    * `:boots` - how many reboots were observed; `:booted_at` - when the last one was, by its own clock, in the time of `:seen`
    * `:busy_with` - what it accepted and has not told the end of: the sensor that it calibrates
    * `:seen` - when each group was last heard, in the time of the frames (microseconds)
  """
  @type t :: %__MODULE__{
          system: pos_integer(),
          component: 1..255,
          version: 1 | 2,
          autopilot: Aerie.Vehicle.Firmware.name(),
          kind: String.t(),
          us: {non_neg_integer(), non_neg_integer()},
          mode: String.t() | nil,
          mode_names: %{non_neg_integer() => String.t()},
          armed: boolean() | nil,
          standard_modes: %{String.t() => non_neg_integer()},
          arming_checks: [String.t()],
          in_air: boolean() | nil,
          vtol_state: String.t() | nil,
          lat: float() | nil,
          lon: float() | nil,
          alt_msl: float() | nil,
          alt_rel: float() | nil,
          heading: float() | nil,
          home: %{lat: float(), lon: float(), alt_msl: float()} | nil,
          mission_seq: non_neg_integer() | nil,
          gcs: {integer(), integer()} | nil,
          gimbal_manager: 1..255 | nil,
          params: %{String.t() => number()},
          boots: non_neg_integer(),
          booted_at: integer() | nil,
          busy_with: String.t() | nil,
          seen: %{group() => integer()}
        }

  @doc "Whether it can fly at all."
  @spec flies?(t()) :: boolean()
  def flies?(%{kind: kind}), do: Aerie.Vehicle.Protocol.Kind.flies?(kind)

  @doc "The steps; an error if the vehicle is known to be on the ground, where the firmwares accept them but nothing moves."
  @spec airborne(t(), steps) :: steps | {:error, String.t()} when steps: term()
  def airborne(vehicle, steps),
    do: if(vehicle.in_air == false and flies?(vehicle), do: {:error, Refusal.text(:on_ground)}, else: steps)

  @doc "Height above mean sea level of a height with its reference; `{:error, reason}` if the height of home is not known."
  @spec msl(t(), float(), String.t()) :: {:ok, float()} | {:error, String.t()}
  def msl(_vehicle, altitude, "msl"), do: {:ok, altitude}
  def msl(%{home: %{alt_msl: home}}, altitude, "home") when is_number(home), do: {:ok, home + altitude}
  def msl(_vehicle, _altitude, "home"), do: {:error, Refusal.text(:home_height_unknown)}
  def msl(_vehicle, _altitude, "terrain"), do: {:error, Refusal.text(:no_terrain)}
end
