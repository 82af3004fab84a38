defmodule Aerie.Control.CommandExecutor.Verdict do
  @moduledoc """
  What is known of a step when its time is up. Pure.

  | answer | state | result |
  |---|---|---|
  | accepted | shows it | `completed` |
  | accepted | is heard and does not show it, what it would do at once | `failed` |
  | accepted | is heard and does not show it, what takes its time | `timeout` |
  | accepted | is not heard | `unknown` |
  | a repetition was refused | shows it | `completed` |
  | a repetition was refused | is heard and does not show it | the refusal; `timeout` if it may be at it |
  | a repetition was refused | is not heard, or could not show it | `unknown` |
  | none | shows it | `completed` |
  | none | is heard and does not show it | `timeout` |
  | none | is not heard, or could not show it | `unknown` |
  """

  alias Aerie.Vehicle.Command.{Refusal, Result}
  alias Aerie.Vehicle.Protocol.{Condition, Vehicle}
  alias Aerie.Control.CommandExecutor.Job

  @doc """
  The result of a step that nothing more is waited for. State that came within `margin` microseconds of the answer may have
  left the vehicle before the command arrived there, and shows nothing.
  """
  @spec of(Job.t(), Vehicle.t(), margin :: non_neg_integer()) :: {Result.status(), String.t() | nil}
  def of(%{steps: [%{confirm: condition} | _others]} = job, _vehicle, _margin)
      when condition in [nil, :told] do
    cond do
      job.refusal != nil -> Refusal.ended(:repetition_refused, why: elem(job.refusal, 1))
      answered?(job) -> Refusal.ended(:no_end)
      true -> Refusal.ended(:unacknowledged)
    end
  end

  def of(%{steps: [%{confirm: condition} | _others]} = job, vehicle, margin) do
    seen = Condition.seen(condition, vehicle)
    since = (job.accepted_at || job.last_sent) + margin

    cond do
      seen == nil or seen <= since ->
        Refusal.ended(:state_unheard, answer: first(job))

      Job.met?(job, vehicle) ->
        if answered?(job), do: {:completed, nil}, else: Refusal.ended(:shown)

      true ->
        not_shown(job, condition, Condition.describe(condition, vehicle))
    end
  end

  defp not_shown(%{refusal: {status, reason}}, _condition, _words) when status != :busy, do: {status, reason}

  defp not_shown(job, condition, words) do
    if answered?(job) and Condition.immediate?(condition),
      do: Refusal.ended(:not_shown, state: words),
      else: Refusal.ended(:not_shown_yet, answer: first(job), state: words)
  end

  defp answered?(%{accepted_at: at}), do: at != nil

  defp first(%{refusal: {_status, reason}}), do: Refusal.text(:refused_again, why: reason)

  defp first(job),
    do: if(answered?(job), do: Refusal.text(:was_accepted), else: Refusal.text(:unacknowledged))

  @doc "Whether waiting for the state may tell more than what is known now."
  @spec observable?(Job.t()) :: boolean()
  def observable?(%{steps: [%{confirm: condition} | _others]}), do: condition not in [nil, :told]
end
