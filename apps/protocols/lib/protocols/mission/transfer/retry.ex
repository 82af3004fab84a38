defmodule Protocols.Mission.Transfer.Retry do
  @moduledoc """
  Decides when to repeat a message and when to give up (W1). Times are in microseconds.

  Until the link is measured, W1's times apply: 1.5 s for the first message, 250 ms for an item. After that it is the
  measured round trip plus four times its variation (RFC 6298; a repeated message is not measured, because nobody knows
  which copy was answered). W1 gives up after five repetitions. On a link that loses a quarter of the frames in both
  directions this would end nearly every transfer of 500 items, so the vehicle must also have been silent for 15 s.
  """

  @first 1_500_000
  @item 250_000
  @shortest 20_000
  @longest 30_000_000
  @own_repetition 900_000
  @retries 5
  @stall 6_000_000
  @silence 15_000_000

  defstruct [:srtt, :var, :sent_at, :since, :due, kind: :first, tries: 0]

  @type t :: %__MODULE__{
          srtt: number() | nil,
          var: number() | nil,
          sent_at: integer() | nil,
          since: integer() | nil,
          due: integer() | nil,
          kind: :first | :item,
          tries: non_neg_integer()
        }

  @doc "Starts with the round trip of the link, or nil."
  @spec new(non_neg_integer() | nil) :: t()
  def new(nil), do: %__MODULE__{}
  def new(rtt), do: %__MODULE__{srtt: rtt, var: rtt / 2}

  @doc "Records that a new message was sent: the first one of a transfer, or an item."
  @spec sent(t(), :first | :item, integer()) :: t()
  def sent(retry, kind, now) do
    %{retry | kind: kind, tries: 1, sent_at: now, since: now} |> due(now)
  end

  @doc "Records that the message was repeated."
  @spec again(t(), integer()) :: {:again, t()} | :give_up
  def again(retry, now) do
    if retry.tries > @retries and now - retry.since >= max(@silence, 10 * timeout(retry)),
      do: :give_up,
      else: {:again, due(%{retry | tries: retry.tries + 1}, now)}
  end

  @doc "Records the answer to the last message."
  @spec answered(t(), integer()) :: t()
  def answered(%{tries: 1} = retry, now) do
    %{measured(retry, now - retry.sent_at) | since: now}
  end

  def answered(retry, now), do: %{retry | since: now}

  @doc "Whether nothing was heard for so long that the other side has ended the transfer by itself: PX4 does after five seconds."
  @spec stalled?(t(), integer()) :: boolean()
  def stalled?(retry, now), do: now - retry.since >= max(@stall, 5 * timeout(retry))

  @doc "For how long messages under way may still arrive."
  @spec quiet(t()) :: pos_integer()
  def quiet(retry), do: max(2 * timeout(retry), 1_000_000)

  # ArduPilot repeats its requests after a second, so a message that takes that long may not be an answer.
  defp measured(retry, us) when us > @own_repetition, do: retry
  defp measured(%{srtt: nil} = retry, us), do: %{retry | srtt: us, var: us / 2}

  defp measured(retry, us) do
    %{retry | var: 0.75 * retry.var + 0.25 * abs(retry.srtt - us), srtt: 0.875 * retry.srtt + 0.125 * us}
  end

  # The waits grow, so that a slow link is not flooded; on a measured link only from the fourth repetition on.
  defp due(retry, now) do
    patient = if retry.srtt == nil, do: 1, else: 4
    wait = timeout(retry) * Integer.pow(2, retry.tries |> Kernel.-(patient) |> max(0) |> min(10))
    limit = if retry.srtt == nil or retry.kind == :first, do: @first, else: @item
    %{retry | due: now + min(wait, max(limit, 2 * timeout(retry)))}
  end

  defp timeout(%{srtt: nil, kind: :first}), do: @first
  defp timeout(%{srtt: nil}), do: @item
  defp timeout(retry), do: round(retry.srtt + max(4 * retry.var, 10_000)) |> max(@shortest) |> min(@longest)
end
