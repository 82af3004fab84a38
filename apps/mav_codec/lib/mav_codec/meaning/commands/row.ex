defmodule MavCodec.Meaning.Commands.Row do
  @moduledoc "What the gateway knows of one MAV_CMD: a row of `MavCodec.Meaning.Commands`."

  alias MavCodec.Meaning.Commands.Numbers

  @enforce_keys [:id, :name, :class, :permission, :as_command, :as_item, :numbers]
  defstruct @enforce_keys

  @permissions ~w(arm fly mission manual payload telemetry sensors pilot maintain protection force_disarm terminate
                  receiver motors inputs)a

  @typedoc """
  What a source must be allowed to do. It is the least that any form of the command needs; its parameters may make it
  need more.

    * `:arm` - arm and disarm; `:force_disarm` - stop the motors in flight; `:terminate` - end the flight for good
    * `:fly` - move the vehicle, change its mode and home; `:mission` - start and steer a mission, fences
    * `:manual` - steer it by hand or by a stream of set-points
    * `:payload` - cameras, gimbals, grippers, servos; the parachute belongs to `:terminate`
    * `:maintain` - calibrate, test motors, reboot, parameters; `:telemetry` - ask for messages
    * `:protection` - take away what protects a vehicle: its fence, its safety switch, its failsafes and checks
    * `:receiver` - take the place of the pilot's receiver, which is how vehicles with MSP are armed and steered;
      `:motors` - turn their motors on the ground
    * `:sensors` - tell its estimators what they shall believe: positions, corrections; where a fence or a limit of
      height is configured, `:inputs` as well for what may lead it around them
  """
  @type permission :: unquote(Enum.reduce(@permissions, &{:|, [], [&1, &2]}))

  @typedoc """
  What the parameters name, mostly 5 to 7:

    * `:flown` - a place to which the vehicle flies; `:stored` - a place that it keeps, such as a home
    * `:height` - a height to which it flies, at whatever place it is
    * `:climb` - a height above home, in parameter 1
    * `:anywhere` - nobody can tell where the command leads
    * `:none` - no place of the vehicle
  """
  @type place :: :flown | :stored | :height | :climb | :anywhere | :none

  @typedoc """
    * `:class` - whether it only asks for something
    * `:as_command`, `:as_item` - what place it names as COMMAND_LONG or COMMAND_INT, and as an item of a mission
    * `:numbers` - its parameters that are enumerations, flags and indices
  """
  @type t :: %__MODULE__{
          id: 0..65_535,
          name: String.t(),
          class: :command | :question,
          permission: permission(),
          as_command: place(),
          as_item: place(),
          numbers: [{1..7, Numbers.kind()}]
        }

  @doc "All permissions."
  @spec permissions() :: [permission(), ...]
  def permissions, do: @permissions
end
