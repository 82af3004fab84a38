defmodule Aerie.Policy.Facts do
  @moduledoc """
  What a command asks for, in the words that the rules judge by. A command of the table and a raw MAVLink message that
  means the same have the same facts.
  """

  alias Aerie.Command
  alias Aerie.Command.{Type, Types}
  alias Aerie.Policy.Lease

  @enforce_keys [:type, :permission]
  defstruct [
    :type,
    :permission,
    :mode,
    :standard_mode,
    :control,
    path: :none,
    moves?: false,
    ends_flight?: false,
    what: "the target"
  ]

  @typedoc """
  A height in metres: above home, above mean sea level, above the ground there, or `:same`, which the vehicle has already.
  """
  @type height :: {:home | :msl | :terrain, number()} | :same

  @typedoc "A place that a command names. Latitude and longitude nil: where the vehicle is."
  @type place :: %{lat: number() | nil, lon: number() | nil, height: height()}

  @typedoc """
  Where a command brings a vehicle:

    * `{:to, places}` - straight from where it is to the first place, from there to the next …
    * `{:along, places}` - from place to place; how it gets to the first one is not known
    * `{:from, place, place}` - from one place to another
    * `{:at, places}` - places that are stored: a home, corners of a fence
    * `{:around, place, metres}` - to the nearest point of a circle, and around on it
    * `{:offset, {north, east, down}}` - so many metres from home
    * `{:shift, frame, {x, y, down}}` - so many metres from where it is: x to the north and y to the east, or, in the frame
      `:body`, ahead and to the right; `{:drift, frame, {x, y, down}}` - so many metres a second
  """
  @type path ::
          :none
          | {:to | :along | :at, [place()]}
          | {:from, place(), place()}
          | {:around, place(), number()}
          | {:offset, {number(), number(), number()}}
          | {:shift | :drift, :north | :body, {number(), number(), number()}}

  @typedoc """
    * `:permission` - what a source must be allowed to do (`t:Aerie.Command.Type.permission/0`)
    * `:mode` - the mode that it asks for, by its name; `:standard_mode` - by that of MAVLink's standard modes
    * `:control` - how it changes who is in charge of the vehicle
    * `:moves?` - the vehicle may move because of it
    * `:ends_flight?` - it holds the vehicle or brings it down; only roles, conditions and modes keep such a command from it
    * `:what` - what refusals call the place that it names
  """
  @type t :: %__MODULE__{
          type: String.t(),
          permission: Type.permission(),
          mode: String.t() | nil,
          standard_mode: String.t() | nil,
          control: Lease.change() | nil,
          path: path(),
          moves?: boolean(),
          ends_flight?: boolean(),
          what: String.t()
        }

  @ending ~w(disarm force_disarm land rtl hold mission_pause parachute terminate)

  # Modes that do the same, by the names of all firmwares, and MAVLink's standard modes.
  @ending_modes ~w(RTL SMART_RTL AUTO_RTL QRTL LAND AUTO_LAND QLAND AUTO_PRECLAND LOITER AUTO_LOITER QLOITER QHOVER POSHOLD
    BRAKE HOLD SURFACE)
  @ending_standard ~w(position_hold safe_recovery land)

  @raw ~w(mission_upload fence_upload rally_upload set_parameter write_file payload raw)

  @doc "Types that are no command of the table: what raw MAVLink asks for besides (`Aerie.Policy.Raw`)."
  @spec raw() :: [String.t()]
  def raw, do: @raw

  @doc "Commands that hold a vehicle or bring it down."
  @spec ending() :: [String.t()]
  def ending, do: @ending

  @doc "The facts of a command that was checked by the table (`Aerie.Command.parse/2`)."
  @spec of(Command.t()) :: t()
  def of(command), do: named(command.type, asked(command.type, command.params))

  @doc "The facts of a type of the table, with some of their own."
  @spec named(String.t(), keyword()) :: t()
  def named(name, fields \\ []) do
    type = Types.fetch!(name)

    facts = %__MODULE__{
      type: type.name,
      permission: type.permission,
      moves?: type.moves_vehicle?,
      ends_flight?: type.name in @ending
    }

    facts |> struct!(fields) |> ending_mode()
  end

  defp ending_mode(%{mode: nil, standard_mode: nil} = facts), do: facts

  defp ending_mode(facts) do
    %{
      facts
      | ends_flight?:
          (facts.mode || "") |> String.upcase() |> Kernel.in(@ending_modes) or
            facts.standard_mode in @ending_standard
    }
  end

  defp asked("takeoff", %{altitude: metres}),
    do: [path: {:to, [here({:home, metres})]}, what: "the height to climb to"]

  defp asked("goto", params), do: [path: {:to, [place(params)]}]
  defp asked("setpoint_position", params), do: [path: {:to, [place(params)]}]
  defp asked("set_altitude", params), do: [path: {:to, [place(params)]}, what: "the height to fly at"]
  defp asked("orbit", params), do: [path: {:around, place(params), params.radius}, what: "the circle"]
  defp asked("setpoint_local", params), do: [path: {:offset, {params.north, params.east, params.down}}]

  defp asked("setpoint_velocity", params) do
    frame = if params.frame == "body", do: :body, else: :north
    [path: {:drift, frame, {params.vx, params.vy, params.vz}}, what: "where that velocity leads within 3 s"]
  end

  defp asked("set_home", %{lat: lat, lon: lon, altitude_msl: metres}),
    do: [path: {:at, [%{lat: lat, lon: lon, height: {:msl, metres}}]}, what: "the new home"]

  defp asked("set_home", _here), do: [path: {:at, [here(:same)]}, what: "the new home"]
  defp asked("set_mode", params), do: [mode: params[:mode], standard_mode: params[:standard_mode]]
  defp asked("take_control", params), do: [control: {:take, params[:reason], nil}]
  defp asked("hand_over_control", params), do: [control: {:offer, params[:to] || :anyone}]
  defp asked("release_control", _params), do: [control: :release]
  # Only a release brings it down.
  defp asked("parachute", params), do: [ends_flight?: params.action == "release"]
  defp asked(_other, _params), do: []

  defp here(height), do: %{lat: nil, lon: nil, height: height}
  defp place(params), do: %{lat: params[:lat], lon: params[:lon], height: height(params)}

  defp height(%{altitude: metres, altitude_reference: "msl"}), do: {:msl, metres}
  defp height(%{altitude: metres, altitude_reference: "terrain"}), do: {:terrain, metres}
  defp height(%{altitude: metres}), do: {:home, metres}
  defp height(_none), do: :same
end
