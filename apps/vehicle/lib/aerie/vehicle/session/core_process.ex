defmodule Aerie.Vehicle.Session.CoreProcess do
  @moduledoc """
  What the processes beside a vehicle's session have in common: which messages they ask the session for, and the timer of their
  pure core. Their state has `:gateway`, `:options`, `:listening` and `:timer`; the timer's message is `{:timeout, timer, :wake}`.
  """

  alias Aerie.Base.Names

  @doc "Asks the session for the messages with these ids, and `:snapshots`, unless it was asked for the same. nil: for nothing."
  @spec listen(state, [non_neg_integer() | :snapshots] | nil) :: state when state: map()
  def listen(%{listening: ids} = state, ids), do: state

  def listen(state, ids) do
    session = Names.whereis(state.gateway, :session, state.options.key)
    if session, do: send(session, {:listen, self(), ids})
    %{state | listening: ids}
  end

  @doc "Sets the timer to a time of `now/0`; nil: none is needed."
  @spec schedule(state, integer() | nil) :: state when state: map()
  def schedule(%{timer: {_timer, at}} = state, at), do: state

  def schedule(%{timer: timer} = state, at) do
    _remaining = if timer, do: :erlang.cancel_timer(elem(timer, 0))
    %{state | timer: at && {start_timer(at), at}}
  end

  # Rounded up: a timer that is early by part of a millisecond would be started again and again.
  defp start_timer(at), do: :erlang.start_timer(max(div(at - now() + 999, 1000), 0), self(), :wake)

  @doc "The clock of the cores: monotonic microseconds."
  @spec now() :: integer()
  def now, do: System.monotonic_time(:microsecond)
end
