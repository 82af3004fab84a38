defmodule Aerie.Vehicle.Reports.Checks do
  @moduledoc """
  What keeps a PX4 vehicle from being armed, from its EVENT messages. A pure value.

  A report of the arming checks is a batch: `commander_arming_check_summary`, the reasons one by one,
  `commander_health_summary`. It says all there is to say, and is sent again whenever something in it changes. A batch
  whose last piece does not come within #{5} s is no batch; one with another piece missing is taken for what there is of it.
  """

  import Bitwise

  alias Aerie.Vehicle.Reports.Names

  @wait_us 5_000_000
  @max_pieces 64

  defstruct [:first, :last, :until, members: %{}, others: 0]

  @type t :: %__MODULE__{}

  @doc """
  Takes one event of the component, by its sequence number. `{:taken, …}`: it is a piece of a batch, not to be shown by
  itself. The list is that of a batch that is complete now, in order; nil for none.
  """
  @spec event(t() | nil, 0..65_535, non_neg_integer(), term(), integer()) ::
          {:taken | :other, t() | nil, [term()] | nil}
  def event(checks, number, id, what, at) do
    case {checks, Names.name(id)} do
      {_before, "commander_arming_check_summary"} ->
        {:taken, %__MODULE__{first: number, until: at + @wait_us}, nil}

      {nil, "commander_health_summary"} ->
        {:taken, nil, nil}

      {checks, "commander_health_summary"} ->
        close(:taken, %{checks | last: number})

      {nil, _any} ->
        {:other, nil, nil}

      {checks, name} ->
        cond do
          not within?(checks, number) -> {:other, checks, nil}
          reason?(name) -> close(:taken, %{checks | members: Map.put(checks.members, number, what)})
          # Of another part of the firmware, sent in between.
          true -> close(:other, %{checks | others: checks.others + 1})
        end
    end
  end

  @doc "It is `now`: a batch that waits too long is ended."
  @spec expire(t() | nil, integer()) :: {t() | nil, [term()] | nil}
  def expire(%{until: until, last: last} = checks, now) when until <= now,
    do: {nil, if(last, do: reasons(checks))}

  def expire(checks, _now), do: {checks, nil}

  defp within?(%{first: first, last: last}, number) do
    end_of = if last, do: last - first &&& 0xFFFF, else: @max_pieces
    (number - first &&& 0xFFFF) in 1..end_of//1
  end

  # One whose name is not known may well be one.
  defp reason?(nil), do: true
  defp reason?(name), do: String.starts_with?(name, "check_")

  defp close(what, %{last: nil} = checks), do: {what, checks, nil}

  defp close(what, checks) do
    if map_size(checks.members) + checks.others >= (checks.last - checks.first - 1 &&& 0xFFFF),
      do: {what, nil, reasons(checks)},
      else: {what, checks, nil}
  end

  defp reasons(%{first: first, members: members}) do
    members |> Enum.sort_by(fn {number, _what} -> number - first &&& 0xFFFF end) |> Enum.map(&elem(&1, 1))
  end
end
