defmodule MavRouter.Recorder.Core do
  @moduledoc """
  Which frames are recorded, and when a file ends: a value, without clock, disk or process.

  `:armed` follows the heartbeats among the frames: it records from the first one that says armed, of any vehicle, until `after_us`
  after all are disarmed. `{:until, at}` records up to a time. Times are those of the frames.
  """

  alias MavCodec.Meaning.Heartbeat
  alias MavCodec.Frame

  @heartbeat Heartbeat.id()
  @armed_flag 0x80
  @max_systems 1024

  @enforce_keys [:mode]
  defstruct [:mode, :until, after_us: 0, armed: MapSet.new(), on: false]

  @type mode :: :off | :armed | :always | {:until, integer}
  @type t :: %__MODULE__{
          mode: mode,
          after_us: non_neg_integer,
          until: integer | nil,
          armed: MapSet.t(),
          on: boolean
        }

  @doc "A recording in a mode; `after_us` is how long it goes on after disarming."
  @spec new(mode, non_neg_integer) :: t
  def new(mode, after_us), do: %__MODULE__{mode: mode, after_us: after_us}

  @doc "Sets another mode; which vehicles are armed is kept."
  @spec mode(t, mode) :: t
  def mode(core, mode), do: %{core | mode: mode, until: nil}

  @doc """
  The frames to be recorded, in order, with `:close` where a recording ends.
  """
  @spec frames(t, [Frame.t()]) :: {t, [[Frame.t()] | :close]}
  def frames(%{mode: :off} = core, _frames), do: stop(core)
  def frames(%{mode: :always} = core, frames), do: {%{core | on: true}, [frames]}

  def frames(core, frames) do
    {core, parts} =
      Enum.reduce(frames, {core, []}, fn frame, {core, parts} ->
        core = if core.mode == :armed, do: arming(core, frame), else: core

        cond do
          on?(core, frame.at) -> {%{core | on: true}, keep(parts, frame)}
          core.on -> {%{core | on: false}, [:close | parts]}
          true -> {core, parts}
        end
      end)

    {core, parts |> Enum.reverse() |> Enum.map(&in_order/1)}
  end

  defp keep([frames | parts], frame) when is_list(frames), do: [[frame | frames] | parts]
  defp keep(parts, frame), do: [[frame] | parts]
  defp in_order(:close), do: :close
  defp in_order(frames), do: Enum.reverse(frames)

  @doc "Ends the recording."
  @spec stop(t) :: {t, [:close]}
  def stop(%{on: true} = core), do: {%{core | on: false}, [:close]}
  def stop(core), do: {core, []}

  defp on?(%{mode: {:until, until}}, at), do: at <= until
  defp on?(%{armed: armed, until: until}, at), do: MapSet.size(armed) > 0 or (until != nil and at <= until)

  # F7: bytes that were cut off are zeros, and zero is disarmed.
  defp arming(core, %Frame{id: @heartbeat, crc_extra: extra} = frame) when extra != nil do
    cond do
      not Heartbeat.vehicle?(Heartbeat.read(frame)) -> core
      armed?(frame.payload) -> armed(core, frame.system)
      MapSet.member?(core.armed, frame.system) -> disarmed(core, frame)
      true -> core
    end
  end

  defp arming(core, _frame), do: core

  defp armed?(<<_custom_mode::32, _type, _autopilot, base_mode, _::binary>>),
    do: Bitwise.band(base_mode, @armed_flag) != 0

  defp armed?(_cut), do: false

  defp armed(core, system) do
    if MapSet.size(core.armed) < @max_systems,
      do: %{core | armed: MapSet.put(core.armed, system)},
      else: core
  end

  defp disarmed(core, frame) do
    %{core | armed: MapSet.delete(core.armed, frame.system), until: frame.at + core.after_us}
  end
end
