defmodule Aerie.Vehicle.Services.Reports.Checks do
  @wait_us 5_000_000

  @moduledoc """
  What keeps a PX4 vehicle from being armed, from its EVENT messages. A pure value.

  The arming checks come as a batch: `commander_arming_check_summary`, the reasons one by one,
  `commander_health_summary`. A batch is complete in itself, and is sent again whenever something in it changes. A batch
  whose last event does not come within #{div(@wait_us, 1_000_000)} s is dropped; one with another event missing is used
  without it.
  """

  import Bitwise

  @max_pieces 64

  defstruct [:first, :last, :until, members: %{}, others: 0]

  @type t :: %__MODULE__{}

  @doc """
  An event of the component with its sequence number and its name, nil if that is unknown. `{:taken, …}`: it is part of
  a batch and is not shown by itself. The list has the reasons of a batch that is complete now, in order; nil if there
  is none.
  """
  @spec event(t() | nil, 0..65_535, String.t() | nil, term(), integer()) ::
          {:taken | :other, t() | nil, [term()] | nil}
  def event(checks, number, name, what, at) do
    case {checks, name} do
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
          # An event of another part of the firmware in between.
          true -> close(:other, %{checks | others: checks.others + 1})
        end
    end
  end

  @doc "Ends a batch that has waited too long at `now`."
  @spec expire(t() | nil, integer()) :: {t() | nil, [term()] | nil}
  def expire(%{until: until, last: last} = checks, now) when until <= now,
    do: {nil, if(last, do: reasons(checks))}

  def expire(checks, _now), do: {checks, nil}

  defp within?(%{first: first, last: last}, number) do
    end_of = if last, do: last - first &&& 0xFFFF, else: @max_pieces
    (number - first &&& 0xFFFF) in 1..end_of//1
  end

  # An event with an unknown name may also be a reason.
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
