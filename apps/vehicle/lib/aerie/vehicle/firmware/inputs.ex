defmodule Aerie.Vehicle.Firmware.Inputs do
  @moduledoc """
  What the channels and buttons that an override or a joystick works do to a vehicle of a firmware, by its parameters as
  far as they are known.
  """

  # A value that every firmware ignores.
  @ignored 65_535

  @type channels :: %{pos_integer() => non_neg_integer()}
  @type params :: %{String.t() => number()}

  @typedoc "`:axes` in thousandths, `:buttons` by their number from 0, `:aux` outputs of a joystick."
  @type inputs :: %{
          channels: channels(),
          axes: %{optional(:pitch | :roll | :throttle | :yaw) => integer() | nil},
          buttons: [0..31],
          aux: [1..6]
        }

  @typedoc """
  What a channel or button does, and which one in words:

    * `{:mode, names}` - it changes to one of these modes; empty: to any
    * `{:command, type, permissions}` - the same as a command, and it needs these permissions as well
    * `{:function, number, level}` - a function of ArduPilot's switches (DO_AUX_FUNCTION)
    * `{:output, permission, permissions}` - something else that needs these permissions
    * `:parameter` - it sets a parameter; `:unknown`: nobody here knows
  """
  @type effect :: {why :: String.t(), what()}
  @type what ::
          {:mode, [String.t()]}
          | {:command, String.t(), [atom()]}
          | {:function, non_neg_integer(), 0..2}
          | {:output, atom(), [atom()]}
          | :parameter
          | :unknown

  @doc "The parameters that say what they do on a kind of vehicle, in the order in which they are read."
  @callback params(kind :: String.t()) :: [String.t()]

  @doc "Whether the value of a parameter is kept when it comes."
  @callback keeps?(name :: String.t()) :: boolean()

  @doc "The channels that an override works."
  @callback worked(channels()) :: channels()

  @doc "What an override, of these channels, or a joystick does."
  @callback effects(inputs(), kind :: String.t() | nil, params()) :: [effect()]

  @doc "Whether a channel is left as it is by a value that every firmware ignores."
  @spec ignored?(pos_integer(), non_neg_integer()) :: boolean()
  def ignored?(_n, @ignored), do: true
  def ignored?(n, 0), do: n > 8
  def ignored?(_n, _us), do: false
end
