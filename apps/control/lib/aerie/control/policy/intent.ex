defmodule Aerie.Control.Policy.Intent do
  @moduledoc """
  What a command asks for, in the words that the rules judge by. A command of the table and a raw MAVLink message that
  means the same have the same facts.
  """

  import Bitwise

  alias Aerie.Vehicle.Command
  alias Aerie.Vehicle.Command.{Type, Types}
  alias Aerie.Control.Policy.ControlLease
  alias Aerie.Control.Policy.Intent.Context
  alias Aerie.Control.Policy.Intent.Protection

  @enforce_keys [:type, :permission]
  defstruct [
    :type,
    :permission,
    :label,
    :mode,
    :standard_mode,
    :control,
    :unknown,
    :number,
    :switches,
    also: [],
    modes: [],
    implies: [],
    besides: [],
    reasons: %{},
    path: :none,
    sweep: nil,
    sets: [],
    enters: [],
    moves?: false,
    stored?: false,
    ends_flight?: false,
    what: "the target"
  ]

  @typedoc """
  A height in metres: above home, above mean sea level, above the ground there, or `:same`, which the vehicle has
  already.
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
    * `{:around, place, metres}` - to the nearest point of a circle, and around on it; `{:ring, place, metres}` - around
      on it, however it gets there
    * `{:offset, {north, east, down}}` - so many metres from the origin of its local coordinates; nil: on that axis it
      stays where it is
    * `{:shift, frame, {x, y, down}}` - so many metres from where it is: x to the north and y to the east, or, in the
      frame `:body`, ahead and to the right
    * `{:drift, drift}` - a velocity (`t:drift/0`); `{:onward, path, drift}` - from the end of a path on
    * `{:level, height}` - to a height, wherever it is then
    * `{:all, paths}` - to each of them, because firmwares read the message in different ways
    * `{:unknown, why}` - a number that it needs is missing: no fence and no limit of height allows it either
    * `:anywhere` - where it leads, nobody can tell: no fence and no limit of height allows it
  """
  @type path ::
          :none
          | :anywhere
          | {:unknown, String.t()}
          | {:all, [path()]}
          | {:level, height()}
          | {:to | :along | :at, [place()]}
          | {:from, place(), place()}
          | {:around | :ring, place(), number()}
          | {:offset, {number() | nil, number() | nil, number() | nil}}
          | {:shift, :north | :body, {number(), number(), number()}}
          | {:drift, drift()}
          | {:onward, path(), drift()}

  @typedoc """
  What happens at the places of a path, by which `Aerie.Vehicle.Firmware.Room` tells the room that it
  takes; a radius that is nil or 0 is the vehicle's own:

    * `{:stay, radius}` - it stays there; `{:turns, radius}` - it circles there, whatever it is
    * `{:pass, acceptance, beyond}` - it flies on; `:curve` - it comes there by a curve
    * `{:land, metres}` - it lands, and climbs so high if the landing is aborted
    * `:takeoff`, and with the metres to climb `{:takeoff, metres}`
  """
  @type sweep ::
          nil
          | {:stay | :turns, number() | nil}
          | {:pass, number(), number()}
          | :curve
          | {:land, number()}
          | :takeoff
          | {:takeoff, number()}

  @typedoc """
  A velocity in m/s and an acceleration in m/s². `:frame` - `:any`: in whichever direction; `:hold` - for how many
  seconds the gateway repeats it; `:vertical?` - whether it changes the height.
  """
  @type drift :: %{
          frame: :north | :body | :any,
          velocity: {number(), number(), number()},
          acceleration: {number(), number(), number()},
          hold: number(),
          vertical?: boolean()
        }

  @typedoc """
  What works channels of the remote control; `:unknown` for a message that says so in no way that is known here.

    * `:channels` - RC_CHANNELS_OVERRIDE's values by the numbers of the channels, as they are sent: what ignores or
      gives back a channel depends on the firmware (`Aerie.Control.Policy.Switches`)
    * `:axes` - a joystick's, in thousandths; nil for one that is missing
    * `:buttons` - those that are pressed, from 0; `:aux` - the numbers of MANUAL_CONTROL's outputs that are set
  """
  @type switches ::
          %{
            channels: %{(1..18) => 0..65_535},
            axes: %{optional(:pitch | :roll | :throttle | :yaw) => integer() | nil},
            buttons: [0..31],
            aux: [1..6]
          }
          | :unknown

  @typedoc "Where a vehicle goes on with its mission: at an item, a tag, its landing, or its current item."
  @type entry :: {:item | :tag, integer()} | :landing | :current

  @typedoc "A parameter and its new value, nil if that is not known."
  @type setting :: {name :: String.t() | nil, number() | nil}

  @typedoc "A message by its id, or a command of MAV_CMD."
  @type unknown :: {:message, non_neg_integer()} | {:command, non_neg_integer()}

  @typedoc """
    * `:permission` - what a source must be allowed to do (`t:Aerie.Vehicle.Command.Type.permission/0`)
    * `:label` - what refusals call it, where its type is not in the table of commands
    * `:also` - permissions that it needs besides; `:reasons` - why, for those of which the name alone does not say it
    * `:unknown` - that no table of the gateway knows the message or command; `:number` - what is wrong with one of its
      numbers
    * `:mode` - the mode that it asks for, by its name; `:modes` - others for which a firmware may take it;
      `:standard_mode` - the mode by the name of MAVLink's standard modes
    * `:implies` - the types that it amounts to while the vehicle is on the ground: what may make it take off or arm
    * `:besides` - types that it is as well, wherever the vehicle is
    * `:control` - how it changes who is in charge of the vehicle
    * `:moves?` - the vehicle may move because of it; `:stored?` - it comes as raw MAVLink, and a disarmed vehicle may
      keep it until it is armed
    * `:switches` - channels of the remote control, and buttons, that it works (`t:switches/0`)
    * `:ends_flight?` - it holds the vehicle or brings it down; only roles, conditions and modes keep such a command
      from it
    * `:what` - what refusals call the place that it names
  """
  @type t :: %__MODULE__{
          type: String.t(),
          permission: Type.permission(),
          label: String.t() | nil,
          also: [Type.permission()],
          reasons: %{Type.permission() => String.t()},
          unknown: unknown() | nil,
          number: String.t() | nil,
          modes: [String.t()],
          implies: [String.t()],
          besides: [String.t()],
          mode: String.t() | nil,
          standard_mode: String.t() | nil,
          control: ControlLease.change() | nil,
          path: path(),
          sweep: sweep(),
          sets: [setting()],
          enters: [entry()],
          moves?: boolean(),
          stored?: boolean(),
          switches: switches() | nil,
          ends_flight?: boolean(),
          what: String.t()
        }

  @ending ~w(disarm force_disarm land rtl hold mission_pause parachute terminate)

  # Modes that do the same, by the names of all firmwares, and MAVLink's standard modes.
  @ending_modes ~w(RTL SMART_RTL AUTO_RTL QRTL LAND AUTO_LAND QLAND AUTO_PRECLAND LOITER AUTO_LOITER QLOITER QHOVER POSHOLD
    BRAKE HOLD SURFACE) ++ ["NAV RTH", "NAV POSHOLD", "GPS RESCUE", "POS HOLD"]
  @ending_standard ~w(position_hold safe_recovery land)

  # Commands that may make a vehicle leave the ground, or arm (PX4 arms at a mission's start).
  @implies Map.merge(
             Map.new(~w(resume jump mission_set_current land_start goto orbit), &{&1, ["takeoff"]}),
             %{"mission_start" => ["takeoff", "arm"]}
           )
  @lifting_modes ~w(AUTO AUTO_MISSION AUTO_READY MISSION TAKEOFF AUTO_TAKEOFF AUTO_VTOL_TAKEOFF GUIDED GUIDED_NOGPS
    GUIDED_COURSE OFFBOARD FOLLOW FOLLOWME AUTO_FOLLOW_TARGET THROW AVOID_ADSB AUTO_RTL) ++
                   ["NAV LAUNCH", "NAV WP", "AUTOPILOT"]
  @lifting_standard ~w(mission takeoff)
  # Commands and modes by which a vehicle goes on with its mission.
  @enters %{"mission_start" => [:current], "resume" => [:current], "land_start" => [:landing]}
  @mission_modes ["AUTO", "AUTO_MISSION", "MISSION", "NAV WP"]
  # They are never in the air.
  @grounded ~w(rover boat sub tracker)

  # PX4's mode that is the end of a flight.
  @termination "TERMINATION"

  @transfers ~w(mission_upload fence_upload rally_upload set_parameter write_file erase_logs payload sensor_input raw)

  @doc "Types outside the table of commands: other requests of raw MAVLink (`Aerie.Control.Policy.Mavlink`)."
  @spec raw() :: [String.t()]
  def raw, do: ["aux_function" | @transfers]

  @doc "Those of them that come as fast as the vehicle asks for them."
  @spec transfers() :: [String.t()]
  def transfers, do: @transfers

  @doc "Whether commands of a type come in streams: set-points and sticks."
  @spec stream?(String.t()) :: boolean()
  def stream?(type), do: String.starts_with?(type, "setpoint_") or type in ~w(rc_override manual_control)

  @doc "Commands that hold a vehicle or bring it down."
  @spec ending() :: [String.t()]
  def ending, do: @ending

  @doc """
  The facts of parameters that are set, by their names and values, or by their names alone; a name that is not known
  is nil.
  """
  @spec set_parameters([setting() | String.t() | nil]) :: t()
  def set_parameters(settings) do
    sets = for setting <- settings, do: if(is_tuple(setting), do: setting, else: {setting, nil})
    guarded = Enum.filter(sets, fn {name, _value} -> name == nil or Protection.parameter?(name) end)

    %__MODULE__{
      type: "set_parameter",
      permission: :maintain,
      label: "setting #{setting(List.first(guarded ++ sets))}",
      also: protection(guarded != []),
      sets: sets
    }
  end

  defp setting({name, _value}) when is_binary(name), do: shown(name)
  defp setting(_no_name), do: "a parameter that has no name here"

  # What a sender wrote, as far as it can be shown.
  defp shown(text) do
    [text | _rest] = :binary.split(text, <<0>>)
    if String.printable?(text), do: String.slice(text, 0, 60), else: inspect(text, limit: 20)
  end

  # MAV_COMP_ID_CAMERA to CAMERA6.
  @cameras 100..105

  @doc """
  The facts of parameters of a component that has its own (PARAM_EXT): those of a camera change nothing of a flight.
  `autopilot` is the component that flies, nil where it is not one of these, `:unknown` for a vehicle that is
  not known.
  """
  @spec set_extended([setting() | String.t()], 0..255, 0..255 | nil | :unknown) :: t()
  def set_extended(settings, component, autopilot)
      when component in @cameras and component != autopilot and autopilot != :unknown,
      do: %{set_parameters(settings) | permission: :payload, also: [], sets: []}

  def set_extended(settings, _another, _autopilot), do: set_parameters(settings)

  @doc "The facts of an operation on files that no definition has: it may write anything."
  @spec unknown_operation() :: t()
  def unknown_operation do
    label = "an operation on files that the gateway does not know"
    %__MODULE__{type: "write_file", permission: :maintain, label: label, also: [:protection]}
  end

  @doc "The facts of what a vehicle's estimators and failsafes are given, by the name of the message."
  @spec sensor_input(String.t()) :: t()
  def sensor_input(message) do
    why = "a fence or a limit of height is configured, and #{message} may lead the vehicle around it"
    %__MODULE__{type: "sensor_input", permission: :sensors, reasons: %{inputs: why}}
  end

  @doc "The facts of a file that is written, moved or removed, by its path."
  @spec write_file(String.t()) :: t()
  def write_file(path),
    do: %__MODULE__{
      type: "write_file",
      permission: :maintain,
      label: if(path == "", do: "writing to a file", else: "changing the file #{shown(path)}"),
      also: protection(Protection.file?(path))
    }

  defp protection(true), do: [:protection]
  defp protection(false), do: []

  @doc "What a refusal calls it."
  @spec label(t()) :: String.t()
  def label(facts), do: facts.label || facts.type

  @doc "The facts of a command that was checked by the table (`Aerie.Vehicle.Command.parse/2`)."
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

    %{facts | implies: Map.get(@implies, name, []), enters: Map.get(@enters, name, [])}
    |> struct!(fields)
    |> by_mode()
  end

  @doc "What works nothing, but for the fields that are given (`t:switches/0`)."
  @spec switches(keyword()) :: switches()
  def switches(fields), do: Map.merge(%{channels: %{}, axes: %{}, buttons: [], aux: []}, Map.new(fields))

  @doc "The permissions that something needs of which nobody knows what it does."
  @spec most() :: [Type.permission(), ...]
  def most, do: [:terminate, :force_disarm, :protection, :maintain]

  @doc "Whether a vehicle flies its mission in a mode."
  @spec mission_mode?(String.t() | nil) :: boolean()
  def mission_mode?(mode), do: mode != nil and String.upcase(mode) in @mission_modes

  @doc "The numbers of the buttons that are pressed, from 0."
  @spec pressed(non_neg_integer()) :: [0..31]
  def pressed(bits), do: for(n <- 0..31, (bits >>> n &&& 1) == 1, do: n)

  @doc "A velocity as a drift. Options: `:hold`, `:acceleration`."
  @spec drift(:north | :body | :any, {number(), number(), number()}, keyword()) :: drift()
  def drift(frame, {_x, _y, down} = velocity, options \\ []) do
    {_ax, _ay, faster} = acceleration = Keyword.get(options, :acceleration, {0, 0, 0})

    %{
      frame: frame,
      velocity: velocity,
      acceleration: acceleration,
      hold: Keyword.get(options, :hold, 0),
      vertical?: down != 0 or faster != 0
    }
  end

  @doc "The name, in refusals, of the place to which a velocity leads."
  @spec drift_what() :: String.t()
  def drift_what, do: "where that velocity leads before the vehicle stands"

  @doc "The types by which a command is judged: its own, and on the ground those that it amounts to."
  @spec types(t(), Context.t()) :: [String.t(), ...]
  def types(facts, context), do: [facts.type | facts.besides ++ implied(facts, context)]

  defp implied(_facts, %{in_air: true}), do: []
  defp implied(facts, %{vehicle_type: kind}) when kind in @grounded, do: facts.implies -- ["takeoff"]
  defp implied(facts, _context), do: facts.implies

  defp by_mode(%{mode: nil, standard_mode: nil} = facts), do: facts

  defp by_mode(facts) do
    modes = for mode <- [facts.mode | facts.modes], mode != nil, do: String.upcase(mode)
    standard = facts.standard_mode
    ends? = if modes == [], do: standard in @ending_standard, else: Enum.all?(modes, &(&1 in @ending_modes))
    lifts? = Enum.any?(modes, &lifts?/1) or standard in @lifting_standard

    enters? = Enum.any?(modes, &(&1 in @mission_modes)) or standard == "mission"

    %{
      facts
      | ends_flight?: ends?,
        enters: if(enters?, do: [:current], else: facts.enters),
        implies: Enum.uniq(facts.implies ++ if(lifts?, do: ["takeoff"], else: [])),
        also: Enum.uniq(facts.also ++ if(@termination in modes, do: [:terminate], else: []))
    }
  end

  # The effect of a mode without a name here is unknown.
  defp lifts?("MODE(" <> _number), do: true
  defp lifts?("EXTERNAL" <> _number), do: true
  defp lifts?(mode), do: mode in @lifting_modes

  defp asked("takeoff", %{altitude: metres}),
    do: [path: {:to, [here({:home, metres})]}, sweep: :takeoff, what: "the height to climb to"]

  defp asked(type, params) when type in ["goto", "setpoint_position"],
    do: [path: {:to, [place(params)]}, sweep: {:stay, nil}]

  defp asked("set_altitude", params), do: [path: {:to, [place(params)]}, what: "the height to fly at"]
  defp asked("orbit", params), do: [path: {:around, place(params), params.radius}, what: "the circle"]
  defp asked("setpoint_attitude", _params), do: [path: :anywhere]
  defp asked("setpoint_local", params), do: [path: {:offset, {params.north, params.east, params.down}}]

  # The vehicle turns a velocity ahead and to the right into one to the north and the east each time it comes, and its
  # nose may turn with it.
  defp asked("setpoint_velocity", params) do
    straight? = params.vy == 0 and params.vx >= 0 and (params[:yaw_rate] || 0) == 0
    frame = if params.frame == "body", do: if(straight?, do: :body, else: :any), else: :north
    drift = drift(frame, {params.vx, params.vy, params.vz}, hold: params.hold)
    [path: {:drift, drift}, what: drift_what()]
  end

  # 0 leaves a channel to the pilot, as the values do that are sent for it.
  defp asked("rc_override", params) do
    channels =
      for {us, n} <- Enum.with_index(params.channels, 1),
          into: %{},
          do: {n, if(us == 0 and n <= 8, do: 65_535, else: us)}

    [switches: switches(channels: channels)]
  end

  defp asked("manual_control", params) do
    axes =
      for axis <- [:pitch, :roll, :throttle, :yaw],
          into: %{},
          do: {axis, round(Map.fetch!(params, axis) * 1000)}

    [switches: switches(axes: axes, buttons: pressed(params.buttons))]
  end

  defp asked("set_home", %{lat: lat, lon: lon, altitude_msl: metres}),
    do: [path: {:at, [%{lat: lat, lon: lon, height: {:msl, metres}}]}, what: "the new home"]

  defp asked("set_home", _here), do: [path: {:at, [here(:same)]}, what: "the new home"]
  defp asked("set_mode", params), do: [mode: params[:mode], standard_mode: params[:standard_mode]]
  defp asked("take_control", params), do: [control: {:take, params[:reason], nil}]
  defp asked("hand_over_control", params), do: [control: {:offer, params[:to] || :anyone}]
  defp asked("release_control", _params), do: [control: :release]
  defp asked("mission_set_current", %{seq: seq}), do: [enters: [{:item, seq}]]
  defp asked("jump", %{tag: tag}), do: [enters: [{:tag, tag}]]
  defp asked("set_geofence", %{enabled: false}), do: [also: [:protection]]
  # This also resets the fence and the failsafes.
  defp asked("reset_params", _params), do: [also: [:protection]]
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
