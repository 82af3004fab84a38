defmodule Aerie.Control.CommandExecutor.Turns do
  @moduledoc """
  Turns: one command of each key is in flight, the others wait in the order of their arrival. There is a pause between two,
  because an acknowledgement does not say which of two equal commands it is for (C6, C8). Pure.
  """

  defstruct lanes: %{}

  @typep lane :: %{active: String.t() | nil, waiting: [String.t()], quiet: integer() | nil}
  @type t :: %__MODULE__{lanes: %{term() => lane()}}

  @idle %{active: nil, waiting: [], quiet: nil}

  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc "A command waits behind the others of its key."
  @spec push(t(), key :: term(), id :: String.t()) :: t()
  def push(lanes, key, id), do: update(lanes, key, &%{&1 | waiting: &1.waiting ++ [id]})

  @doc "A command waits before the others: it has begun already."
  @spec push_front(t(), key :: term(), id :: String.t()) :: t()
  def push_front(lanes, key, id), do: update(lanes, key, &%{&1 | waiting: [id | &1.waiting]})

  @doc "The next command whose turn it is, which is in flight from now on."
  @spec next(t(), now :: integer()) :: {id :: String.t(), t()} | nil
  def next(%{lanes: lanes} = all, now) do
    Enum.find_value(lanes, fn
      {key, %{active: nil, waiting: [id | waiting], quiet: quiet} = lane} when quiet == nil or now >= quiet ->
        {id, %{all | lanes: Map.put(lanes, key, %{lane | active: id, waiting: waiting, quiet: nil})}}

      _busy ->
        nil
    end)
  end

  @doc "A command is out of its lane; if it was in flight, the next one's turn is at `quiet`."
  @spec leave(t(), key :: term(), id :: String.t(), quiet :: integer()) :: t()
  def leave(lanes, key, id, quiet) do
    update(lanes, key, fn
      %{active: ^id} = lane -> %{lane | active: nil, quiet: max(lane.quiet || quiet, quiet)}
      lane -> %{lane | waiting: List.delete(lane.waiting, id)}
    end)
  end

  @doc "The next of a key has its turn at `quiet` at the earliest, because of a command of another key; nil: of none."
  @spec hush(t(), key :: term() | nil, quiet :: integer()) :: t()
  def hush(lanes, nil, _quiet), do: lanes
  def hush(lanes, key, quiet), do: update(lanes, key, &%{&1 | quiet: max(&1.quiet || quiet, quiet)})

  @doc "Empties a lane without a quiet after it. Gives whether there was to be one, and who was in flight or waited."
  @spec seize(t(), key :: term()) :: {quiet? :: boolean(), ids :: [String.t()], t()}
  def seize(%{lanes: lanes} = all, key) do
    case lanes do
      %{^key => lane} ->
        {true, List.wrap(lane.active) ++ lane.waiting, %{all | lanes: Map.delete(lanes, key)}}

      _idle ->
        {false, [], all}
    end
  end

  @doc "Whether an answer to a command of this key may still come: one is in flight, or was a moment ago."
  @spec answers?(t(), key :: term(), now :: integer()) :: boolean()
  def answers?(%{lanes: lanes}, key, now) do
    case lanes do
      %{^key => %{active: nil, quiet: quiet}} -> quiet != nil and now < quiet
      %{^key => _in_flight} -> true
      _idle -> false
    end
  end

  @doc "The times at which the quiet of a lane ends that somebody waits for."
  @spec wakes(t()) :: [integer()]
  def wakes(%{lanes: lanes}),
    do: for({_key, %{active: nil, waiting: [_ | _], quiet: quiet}} when quiet != nil <- lanes, do: quiet)

  # A lane with its quiet stays; there are as many as kinds of steps.
  defp update(%{lanes: lanes} = all, key, fun) do
    case fun.(Map.get(lanes, key, @idle)) do
      @idle -> %{all | lanes: Map.delete(lanes, key)}
      lane -> %{all | lanes: Map.put(lanes, key, lane)}
    end
  end
end
