defmodule Aerie.Control.CommandExecutor.Timing do
  @moduledoc """
  How long the executor waits, in microseconds, from the measured round trip of the link (`nil`: not measured yet,
  `:high_latency`: only such links reach the vehicle, on which an answer takes minutes and each copy costs, X6). Pure.
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
  # By satellite a message waits for its turn at both ends, and what a vehicle shows comes with its next summary.
  @slow_answer 45 * @second
  @slow_only_answer 180 * @second
  @slow_sends 3

  @type rtt :: non_neg_integer() | :high_latency | nil

  @doc "How often something that is safe is sent at most."
  @spec sends(rtt()) :: pos_integer()
  def sends(:high_latency), do: @slow_sends
  def sends(_rtt), do: @sends

  @doc "How long an answer may take before it counts as lost; `at_least` for what blocks the vehicle."
  @spec answer(rtt(), at_least :: non_neg_integer()) :: pos_integer()
  def answer(rtt, at_least \\ 0)
  def answer(:high_latency, at_least), do: max(at_least, @slow_answer)
  def answer(rtt, at_least), do: max(at_least, clamp(3 * measured(rtt) + 250 * @ms))

  @doc "How long to wait for the only answer to what is not sent again."
  @spec only_answer(rtt(), at_least :: non_neg_integer()) :: pos_integer()
  def only_answer(rtt, at_least \\ 0)
  def only_answer(:high_latency, at_least), do: max(at_least, @slow_only_answer)
  def only_answer(rtt, at_least), do: max(at_least, 3 * answer(rtt))

  @doc "For how long after an answer another of the same command may still come (C8)."
  @spec quiet(rtt()) :: pos_integer()
  def quiet(:high_latency), do: @slow_answer
  def quiet(rtt), do: clamp(2 * measured(rtt))

  @doc """
  The same of a command that was sent `sends` times. Each sending has one answer, so after the answer to the only one no other comes, unless the link
  doubles a frame: both copies are then under way together.
  """
  @spec quiet(rtt(), sends :: pos_integer()) :: pos_integer()
  def quiet(:high_latency, 1), do: @doubled
  def quiet(rtt, 1) when is_integer(rtt), do: (2 * rtt) |> max(@doubled) |> min(@longest)
  def quiet(rtt, _sends), do: quiet(rtt)

  @doc "For how long a repetition that was answered with \"busy\" may still be answered with the end."
  @spec busy(rtt()) :: pos_integer()
  def busy(:high_latency), do: @slow_answer
  def busy(rtt), do: 4 * answer(rtt)

  @doc "How long the vehicle may take to say why it refused."
  @spec reason(rtt()) :: pos_integer()
  def reason(:high_latency), do: 2 * @second
  def reason(rtt), do: min(max(2 * measured(rtt), 500 * @ms), 2 * @second)

  @doc "How long more of what it says may take after the first of it."
  @spec more() :: pos_integer()
  def more, do: 100 * @ms

  @spec progress(rtt()) :: pos_integer()
  def progress(:high_latency), do: @slow_only_answer
  def progress(_rtt), do: @progress

  @spec observe(rtt()) :: pos_integer()
  def observe(:high_latency), do: @slow_only_answer
  def observe(_rtt), do: @observe

  @spec cancel(rtt()) :: pos_integer()
  def cancel(:high_latency), do: @slow_answer
  def cancel(_rtt), do: @cancel

  @doc "How long to wait for the last word about what another command ends."
  @spec ended() :: pos_integer()
  def ended, do: @ended

  defp measured(nil), do: @unmeasured
  defp measured(us) when is_integer(us), do: us

  defp clamp(us), do: us |> max(@shortest) |> min(@longest)
end
