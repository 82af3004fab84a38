defmodule Aerie.Control.CommandExecutor.Timing do
  @moduledoc """
  How long the executor waits, in microseconds, from the measured round trip of the link (`nil`: not measured yet). Pure.
  """

  @ms 1_000
  @second 1_000_000
  @unmeasured 250 * @ms

  # Sent so often at most, the first time included: at 20 % loss in both directions one in 165 then has no answer.
  @sends 5
  @shortest 500 * @ms
  @longest 30 * @second
  # Between the two copies of a frame that the link doubled.
  @doubled 50 * @ms
  # A vehicle that reports progress may be silent for a while (C4).
  @progress 30 * @second
  # Two heartbeats and a little.
  @observe 2_500 * @ms
  @cancel 5 * @second
  @ended 20 * @second

  @type rtt :: non_neg_integer() | nil

  @doc "How often something that is safe is sent at most."
  @spec sends() :: pos_integer()
  def sends, do: @sends

  @doc "How long an answer may take before it counts as lost; `at_least` for what blocks the vehicle."
  @spec answer(rtt(), at_least :: non_neg_integer()) :: pos_integer()
  def answer(rtt, at_least \\ 0), do: max(at_least, clamp(3 * measured(rtt) + 250 * @ms))

  @doc "How long to wait for the only answer to what is not sent again."
  @spec only_answer(rtt(), at_least :: non_neg_integer()) :: pos_integer()
  def only_answer(rtt, at_least \\ 0), do: max(at_least, 3 * answer(rtt))

  @doc "For how long after an answer another of the same command may still come (C8)."
  @spec quiet(rtt()) :: pos_integer()
  def quiet(rtt), do: clamp(2 * measured(rtt))

  @doc """
  The same of a command that was sent `sends` times. Each sending has one answer, so after the answer to the only one no other comes, unless the link
  doubles a frame: both copies are then under way together.
  """
  @spec quiet(rtt(), sends :: pos_integer()) :: pos_integer()
  def quiet(rtt, 1) when is_integer(rtt), do: (2 * rtt) |> max(@doubled) |> min(@longest)
  def quiet(rtt, _sends), do: quiet(rtt)

  @doc "For how long a repetition that was answered with \"busy\" may still be answered with the end."
  @spec busy(rtt()) :: pos_integer()
  def busy(rtt), do: 4 * answer(rtt)

  @doc "How long the vehicle may take to say why it refused."
  @spec reason(rtt()) :: pos_integer()
  def reason(rtt), do: min(max(2 * measured(rtt), 500 * @ms), 2 * @second)

  @doc "How long more of what it says may take after the first of it."
  @spec more() :: pos_integer()
  def more, do: 100 * @ms

  @spec progress() :: pos_integer()
  def progress, do: @progress

  @spec observe() :: pos_integer()
  def observe, do: @observe

  @spec cancel() :: pos_integer()
  def cancel, do: @cancel

  @doc "How long to wait for the last word about what another command ends."
  @spec ended() :: pos_integer()
  def ended, do: @ended

  defp measured(nil), do: @unmeasured
  defp measured(us) when is_integer(us), do: us

  defp clamp(us), do: us |> max(@shortest) |> min(@longest)
end
