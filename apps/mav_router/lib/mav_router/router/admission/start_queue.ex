defmodule MavRouter.Router.Admission.StartQueue do
  @moduledoc """
  The next waiting vehicle, in turn by the link that brought it, so that hundreds from one link keep none of another
  waiting. A value; who asks bounds it (`MavRouter.Router.Admission`).
  """

  @enforce_keys [:turns]
  defstruct [:turns, waiting: %{}]

  @type t :: %__MODULE__{turns: :queue.queue(term), waiting: %{term => :queue.queue(term)}}

  @doc "Nobody waits."
  @spec new() :: t
  def new, do: %__MODULE__{turns: :queue.new()}

  @doc "One more, brought by `owner`."
  @spec put(t, owner :: term, term) :: t
  def put(%__MODULE__{turns: turns, waiting: waiting} = queue, owner, key) do
    case waiting do
      %{^owner => keys} ->
        %{queue | waiting: %{waiting | owner => :queue.in(key, keys)}}

      _first ->
        %{queue | turns: :queue.in(owner, turns), waiting: Map.put(waiting, owner, :queue.from_list([key]))}
    end
  end

  @doc "The next one, nil if nobody waits."
  @spec take(t) :: {term, t} | nil
  def take(%__MODULE__{turns: turns, waiting: waiting} = queue) do
    with {{:value, owner}, turns} <- :queue.out(turns),
         {{:value, key}, keys} = :queue.out(Map.fetch!(waiting, owner)) do
      if :queue.is_empty(keys),
        do: {key, %{queue | turns: turns, waiting: Map.delete(waiting, owner)}},
        else: {key, %{queue | turns: :queue.in(owner, turns), waiting: %{waiting | owner => keys}}}
    else
      {:empty, _turns} -> nil
    end
  end
end
