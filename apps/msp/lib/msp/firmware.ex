defmodule Msp.Firmware do
  @moduledoc """
  What differs between the firmwares that speak MSP, besides their messages (`MavCodec.Msp.Messages`) and what they are
  asked for (`Msp.Readings`): a table for each, in `firmware/`.
  """

  alias MavCodec.Msp.Messages

  @enforce_keys ~w(name title variant about capabilities missions? settings? quiet_flag? features modes standard returns
    plan prearm arming arming_states rx_lost booting sensors types other_type fixes home_told? receiver
    receiver_setting hands_back nudged?)a
  defstruct @enforce_keys ++ [still: nil]

  @typedoc """
    * `:title` - its name for people; `:variant` - what it says itself (FC_VARIANT)
    * `:about` - what it is asked once after each start
    * `:capabilities` - MAV_PROTOCOL_CAPABILITY of what its session offers
    * `:missions?` - whether it has missions, a home that can be set, and places to be sent to
    * `:settings?` - whether it lists its parameters itself; else they are those of `MavCodec.Msp.Params`
    * `:quiet_flag?` - whether a request with the lowest flag is not answered
    * `:features` - the message that has its features; `:still` - the one that has the pulse of a motor that stands
    * `:modes` - permanent ids of boxes with the names of the modes, the first of those that are on being the mode;
      `:standard` - MAV_STANDARD_MODE by id; `:returns` - the mode that brings it home, `:plan` - the one that flies a
      plan, nil without one; `:prearm` - the box without which it does not arm
    * `:arming` - names of the arming flags by bit, by the first version that has them; `:arming_states` - bits that
      keep nothing from being armed; `:rx_lost` - the bit that says that the receiver is lost, and whether also while it
      is armed; `:booting` - the bit that says that it has just started, by version
    * `:sensors` - bits of sensors, besides those that all have, with the names of MAVLink; `:types` - MAV_TYPE of its
      mixers or platforms, `:other_type` - of any other
    * `:fixes` - GPS_FIX_TYPE by the fix of RAW_GPS; `:other` for the others
    * `:home_told?` - whether it tells its home; else that is where it was armed
    * `:receiver` - what says that MSP is its receiver: a bit of its features, or a value of the setting receiver_type;
      `:receiver_setting` - how it is set, for people
    * `:hands_back` - the first version in which its own receiver's channels count again when overridden ones stop
    * `:nudged?` - whether it does not leave a failsafe before a stick is moved
  """
  @type t :: %__MODULE__{}

  @doc "Its table."
  @callback facts() :: t

  @doc "The version by which its messages are read, and what it is for people; or why it is not a vehicle for Aerie."
  @callback identify(api :: {integer, integer}, release :: String.t(), numbers :: {integer, integer, integer}) ::
              {:ok, {integer, integer}, String.t()} | {:error, String.t()}

  @doc "The modules of all firmwares."
  @spec modules() :: [module]
  def modules, do: [__MODULE__.Betaflight, __MODULE__.Inav]

  @doc "The table of a firmware."
  @spec of(Messages.firmware()) :: t
  def of(name) do
    Enum.find_value(modules(), fn module -> if module.facts().name == name, do: module.facts() end)
  end

  @doc "By which messages are read that are the same in all firmwares, as long as it is not known which one it is."
  @spec any() :: MavCodec.Msp.Guard.target()
  def any, do: {hd(modules()).facts().name, nil}
end
