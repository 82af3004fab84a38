defmodule Aerie.Vehicle.Services.Switches do
  @moduledoc """
  The parameters of a vehicle on which rules of the policy and adapters depend: what its mode switch, channels and
  buttons do, whether and for how long it obeys overrides and set-points, and how wide its paths are
  (`MavCodec.Meaning.Shaping`). A pure value.

  They are read once, a few at a time, after those of `Aerie.Vehicle.Services.Gcs`, and again after a reboot; any other
  PARAM_VALUE that comes is used as well.
  """

  alias MavCodec.Messages.ParamRequestRead

  @first_us 15_000_000
  @pause_us 1_000_000
  @at_once 4
  @tries 2

  slots = fn name -> for n <- 1..6, do: "#{name}#{n}" end
  options = for n <- 1..16, do: "RC#{n}_OPTION"
  sticks = ~w(RCMAP_ROLL RCMAP_PITCH RCMAP_THROTTLE RCMAP_YAW)
  overrides = ~w(RC_OVERRIDE_TIME RC_OPTIONS)

  @flying ["FLTMODE_CH", "GUID_TIMEOUT"] ++
            overrides ++
            slots.("FLTMODE") ++ Enum.drop(options, 4) ++ sticks ++ Enum.take(options, 4) ++ ["TUNE"]
  @driving ["MODE_CH"] ++
             overrides ++ slots.("MODE") ++ Enum.drop(options, 4) ++ sticks ++ Enum.take(options, 4)
  @diving overrides ++ for(n <- 0..31, end_ <- ~w(FUNCTION SFUNCTION), do: "BTN#{n}_#{end_}") ++ options
  # Some versions lack the first two. The others are known only after these had their turn.
  @px4 ~w(
    RC_MAP_TERM_SW RC_MAP_ENG_MOT COM_OF_LOSS_T COM_RC_IN_MODE RC_MAP_KILL_SW RC_MAP_ARM_SW RC_MAP_TRANS_SW
    RC_MAP_FLTMODE RC_MAP_FLTM_BTN RC_MAP_RETURN_SW RC_MAP_LOITER_SW RC_MAP_OFFB_SW RC_MAP_ROLL RC_MAP_PITCH
    RC_MAP_THROTTLE RC_MAP_YAW RC_MAP_FAILSAFE RC_MAP_GEAR_SW RC_MAP_PARAM1 RC_MAP_PARAM2 RC_MAP_PARAM3
    RC_MAP_AUX1 RC_MAP_AUX2 RC_MAP_AUX3 RC_MAP_AUX4 RC_MAP_AUX5 RC_MAP_AUX6 RC_MAP_PAY_SW MAN_KILL_GEST_T
  )
  # Names in old versions.
  @more ~w(RC_MAP_MODE_SW RC_MAP_ACRO_SW RC_MAP_STAB_SW RC_MAP_MAN_SW RC_MAP_POSCTL_SW RC_MAP_RATT_SW)
  @shaping for row <- MavCodec.Meaning.Shaping.all(), row.metres != nil, do: row.name
  @names MapSet.new(@flying ++ @driving ++ @diving ++ @px4 ++ @more ++ @shaping)

  defstruct params: %{}, asked: %{}, next: nil

  @typedoc "`:asked` - how often each was requested since the vehicle's boot; `:next` - when the next ones are due."
  @type t :: %__MODULE__{
          params: %{String.t() => number()},
          asked: %{String.t() => pos_integer()},
          next: integer() | nil
        }

  @doc "Nothing known, or what a snapshot's `params` shows."
  @spec new(map() | nil) :: t()
  def new(params \\ nil), do: %__MODULE__{params: params || %{}}

  @doc "The value of any parameter."
  @spec param(t(), String.t(), number()) :: t()
  def param(switches, name, value) do
    if name in @names, do: %{switches | params: Map.put(switches.params, name, value)}, else: switches
  end

  @doc "After a reboot they are read again: they may have been changed before it."
  @spec rebooted(t(), integer()) :: t()
  def rebooted(_switches, at), do: %__MODULE__{next: at + @first_us}

  @doc "Time goes on from `now`, which is not comparable with the time before."
  @spec rebased(t(), integer()) :: t()
  def rebased(switches, now), do: %{switches | next: switches.next && now + @pause_us}

  @doc "The clock was set by `step` (us)."
  @spec shifted(t(), integer()) :: t()
  def shifted(switches, step), do: %{switches | next: switches.next && switches.next + step}

  @doc "The requests that are due at `now` to a vehicle of a firmware and a kind."
  @spec due(t(), integer(), target :: {integer(), integer()}, firmware :: {atom(), String.t()}) ::
          {t(), [%ParamRequestRead{}]}
  def due(%{next: nil} = switches, now, _target, _firmware), do: {%{switches | next: now + @first_us}, []}
  def due(%{next: next} = switches, now, _target, _firmware) when now < next, do: {switches, []}

  def due(switches, now, {system, component}, firmware) do
    wanted =
      (plan(firmware) ++ MavCodec.Meaning.Shaping.read_by(elem(firmware, 0), elem(firmware, 1)))
      |> Enum.filter(&(not is_map_key(switches.params, &1) and Map.get(switches.asked, &1, 0) < @tries))
      |> Enum.take(@at_once)

    asked = Enum.reduce(wanted, switches.asked, fn name, asked -> Map.update(asked, name, 1, &(&1 + 1)) end)
    request = %ParamRequestRead{target_system: system, target_component: component, param_index: -1}
    {%{switches | asked: asked, next: now + @pause_us}, for(name <- wanted, do: %{request | param_id: name})}
  end

  @doc "The parameters that are read from a vehicle of a firmware and a kind."
  @spec plan(firmware :: {atom(), String.t()}) :: [String.t()]
  def plan({:px4, _kind}), do: @px4
  def plan({:ardupilot, kind}) when kind in ["rover", "boat"], do: @driving
  def plan({:ardupilot, "sub"}), do: @diving
  def plan({:ardupilot, _kind}), do: @flying
  def plan(_generic), do: []
end
