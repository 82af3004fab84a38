defmodule Aerie.Access.WorkLimit.Places do
  @moduledoc """
  Places for work that costs more than a page: so many of a kind at once, a few wait, the rest is refused. Pure.

  Each requester has one piece of work of a kind waiting or running at a time, so none fills the places alone. Known requesters (`known?`)
  have a queue of their own, which comes first.
  """

  @waiting 16

  @enforce_keys [:most]
  defstruct [:most, running: %{}, queues: %{}, askers: MapSet.new()]

  @type kind :: atom()
  @type t :: %__MODULE__{}

  @doc "`most`: how many of each kind are done at once."
  @spec new(%{kind() => pos_integer()}) :: t()
  def new(most), do: %__MODULE__{most: most}

  @doc "Somebody asks for work of a kind."
  @spec ask(t(), kind(), asker :: term(), known? :: boolean(), request :: term()) ::
          {:run, t()} | {:wait, t()} | :busy
  def ask(places, kind, asker, known?, request) do
    queue = Map.get(places.queues, {kind, known?}, :queue.new())

    cond do
      {kind, asker} in places.askers ->
        :busy

      running(places, kind) < places.most[kind] ->
        {:run, places |> enter(kind) |> asks(kind, asker)}

      :queue.len(queue) >= @waiting ->
        :busy

      true ->
        {:wait,
         places
         |> asks(kind, asker)
         |> put_in([Access.key(:queues), {kind, known?}], :queue.in(request, queue))}
    end
  end

  @doc "A piece of work has ended; gives the request whose turn it is, which runs now."
  @spec done(t(), kind(), asker :: term()) :: {{:ok, term()} | :none, t()}
  def done(places, kind, asker) do
    places = %{
      places
      | running: Map.update!(places.running, kind, &(&1 - 1)),
        askers: MapSet.delete(places.askers, {kind, asker})
    }

    Enum.find_value([true, false], {:none, places}, fn known? ->
      with {:ok, queue} <- Map.fetch(places.queues, {kind, known?}),
           {{:value, request}, queue} <- :queue.out(queue) do
        {{:ok, request}, enter(put_in(places.queues[{kind, known?}], queue), kind)}
      else
        _empty -> nil
      end
    end)
  end

  @doc "How many of a kind are being done."
  @spec running(t(), kind()) :: non_neg_integer()
  def running(places, kind), do: Map.get(places.running, kind, 0)

  defp enter(places, kind), do: %{places | running: Map.update(places.running, kind, 1, &(&1 + 1))}
  defp asks(places, kind, asker), do: %{places | askers: MapSet.put(places.askers, {kind, asker})}
end
