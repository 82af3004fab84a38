defmodule Protocols.Mission.Transfer.Outcome do
  @moduledoc """
  The end of a transfer: status, reason and the plan on board, from how sending ended, what was read back, and
  what the firmware reported about the plan afterwards. Pure.
  """

  alias Protocols.Mission.Result
  alias Protocols.Mission.Transfer.Compare
  alias MavCodec.Enums.MavMissionResult

  @typedoc """
  How sending ended:

    * `:acked` - the vehicle acknowledged the plan
    * `{:doubt, result}` - an error after everything was sent, possibly the answer to a repetition
    * `{:refused, result}` - MAV_MISSION_RESULT, before everything was sent
    * `:cancelled`, `:silent`, `:rebooted`
  """
  @type cause :: :acked | {:doubt | :refused, non_neg_integer()} | :cancelled | :silent | :rebooted

  @typedoc "The last verdict of `c:Protocols.Mission.Firmware.plan_verdict/3`, or nil."
  @type verdict :: :valid | {:invalid | :doubtful, String.t()} | nil

  @type t :: {Result.status(), reason :: String.t() | nil, Result.on_board()}

  @doc "The verdict after another report of the firmware. A rejection stands, because it is reported only once."
  @spec verdict(verdict(), verdict() | :ignore) :: verdict()
  def verdict({:invalid, _reason} = before, said) when not is_tuple(said) or elem(said, 0) != :invalid,
    do: before

  def verdict(before, :ignore), do: before
  def verdict(_before, said), do: said

  @doc "Whether the firmware's check has ended."
  @spec final?(verdict()) :: boolean()
  def final?(verdict), do: verdict == :valid or match?({:invalid, _reason}, verdict)

  @doc """
  The outcome after the plan was read back. `:check` if it is the one that was sent and the firmware may still reject it; `:again` if it has to be
  read a second time, because a late message may have interfered.
  """
  @spec read_back(Compare.t(), cause(), first_look? :: boolean()) ::
          t() | :check | :again
  def read_back({:same, _remarks}, :cancelled, _first?),
    do: {:cancelled, "the vehicle had the whole plan already", :new}

  def read_back({:same, _remarks}, {:refused, result}, _first?), do: {:rejected, refusal(result), :new}
  def read_back({:same, _remarks}, _cause, _first?), do: :check
  def read_back({:differs, _seq, _how}, :acked, true), do: :again

  def read_back({:differs, _seq, how}, cause, _first?) do
    {status, reason} = undone(cause, how)
    {status, reason, :other}
  end

  defp undone(:acked, how), do: {:failed, "the vehicle acknowledged the plan and has another one: " <> how}
  defp undone({_doubt_or_refused, result}, _how), do: {:rejected, refusal(result)}
  defp undone(:cancelled, _how), do: {:cancelled, nil}
  defp undone(:silent, _how), do: {:failed, "the vehicle stopped answering, and does not have the plan"}
  defp undone(:rebooted, _how), do: {:failed, "the vehicle rebooted, and does not have the plan"}

  @doc "The outcome if the plan could not be read back, for this reason."
  @spec unreadable(cause(), String.t()) :: t()
  def unreadable(cause, reason) do
    said =
      case cause do
        :acked -> "the vehicle acknowledged it"
        {_doubt_or_refused, result} -> refusal(result)
        :cancelled -> "it was cancelled"
        :silent -> "the vehicle stopped answering"
        :rebooted -> "the vehicle rebooted"
      end

    {:unknown, "#{said}, and what it has could not be read back: #{reason}", :unknown}
  end

  @stalls "the vehicle stopped answering in the middle of it, however often it was begun again"

  @doc "The outcome if reading was begun again and again, and never came to its end."
  @spec stalled(:upload | :download | :clear, cause() | nil) :: t()
  def stalled(:download, _cause), do: {:timeout, @stalls, :unknown}
  def stalled(_change, cause), do: unreadable(cause, @stalls)

  @doc "The outcome if the plan is on board. `announced?`: whether the firmware reports that such a plan is valid."
  @spec checked(verdict(), announced? :: boolean()) :: t()
  def checked({_invalid_or_doubtful, reason}, _announced?), do: {:rejected, reason, :new}

  def checked(nil, true),
    do: {:accepted, "the vehicle has it, and did not say whether it can be flown", :new}

  def checked(_valid_or_nothing, _announced?), do: {:completed, nil, :new}

  @doc "A refusal with the texts that came with it."
  @spec said(String.t(), [String.t()]) :: String.t()
  def said(reason, []), do: reason
  def said(reason, texts), do: reason <> "; it said: " <> Enum.join(texts, "; ")

  @doc "A refusal in words: MAV_MISSION_RESULT by its name; a sentence as it is."
  @spec refusal(non_neg_integer() | String.t()) :: String.t()
  def refusal(reason) when is_binary(reason), do: reason

  def refusal(result),
    do: "the vehicle refused it: #{MavMissionResult.label(result) || "MAV_MISSION_RESULT #{result}"}"
end
