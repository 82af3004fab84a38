defmodule Aerie.Fleet.Bridge.NatsServer.RestartPolicy do
  @moduledoc """
  Decides when a server that runs but stores nothing is restarted. Pure; times in milliseconds.

  After a failed write, nats-server answers no publisher until it is restarted, even when the disk has room again. A restart is
  useless while the disk is full. If a restart did not help, something else is wrong, so the pauses between restarts grow from
  ten seconds to ten minutes.
  """

  alias Aerie.Base.Timing.Backoff

  # Without jitter: 10 s, 20 s, … 10 min.
  @min_pause_ms 5_000
  @max_pause_ms 600_000
  # With less than this free, the next message could fail.
  @room 1_048_576

  defstruct fault: nil, tries: 0, not_before: nil

  @typedoc "`fault`: why it stores nothing, as text, or nil; `tries`: recent restarts."
  @type t :: %__MODULE__{fault: String.t() | nil, tries: non_neg_integer(), not_before: integer() | nil}

  @doc "A server without a fault."
  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc "The server stores nothing. The first reason is kept, because it causes the others."
  @spec fault(t(), String.t()) :: t()
  def fault(%{fault: nil} = policy, text), do: %{policy | fault: text}
  def fault(policy, _text), do: policy

  @doc "The server was started, for any reason."
  @spec started(t()) :: t()
  def started(policy), do: %{policy | fault: nil}

  @doc "Whether to restart the server now, with so many bytes free on its disk."
  @spec check(t(), integer(), {:ok, non_neg_integer()} | :unknown) :: {:restart | :wait, t()}
  def check(%{fault: nil} = policy, _now, _free), do: {:wait, policy}
  def check(policy, _now, {:ok, free}) when free < @room, do: {:wait, policy}

  def check(%{not_before: nil} = policy, now, _free), do: restart(policy, now)
  def check(%{not_before: at} = policy, now, _free) when now < at, do: {:wait, policy}

  # It worked for a long time, so this is a new fault.
  def check(%{not_before: at} = policy, now, _free) when now - at > @max_pause_ms,
    do: restart(%{policy | tries: 0}, now)

  def check(policy, now, _free), do: restart(policy, now)

  defp restart(policy, now) do
    pause = Backoff.wait(policy.tries + 1, @min_pause_ms, @max_pause_ms, 1.0)
    {:restart, %{policy | tries: policy.tries + 1, not_before: now + pause}}
  end
end
