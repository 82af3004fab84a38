defmodule Aerie.Control.Params.Set.All do
  @moduledoc """
  Sets several parameters one by one (`Aerie.Control.Params.Set`). Pure; events and actions are those of `Aerie.Control.Params.Fetch.Download`,
  with `{:progress, done, total}` after each of them.

  If the vehicle refuses one, the others are set nevertheless. If it does not answer, the rest is not tried. The end is
  `{:done, {:ok, count} | {:error, reason}}`: `{:failed, text}` names the refused ones, the other reasons are those of `Set`.
  """

  alias Aerie.Control.Params.{Message, Set}
  alias Aerie.Control.Policy.Mavlink.SystemId
  alias Aerie.Vehicle.Command.Refusal

  @shown 20

  @enforce_keys [:target, :deadline, :options, :left, :total]
  defstruct [:target, :deadline, :options, :left, :total, :set, done: 0, refused: []]

  @type t :: %__MODULE__{}

  @doc "With `{name, value, type or nil}`; options are those of `Set`."
  @spec new(
          [{String.t(), number(), 1..10 | nil}],
          Message.target(),
          deadline :: integer(),
          keyword()
        ) :: t()
  def new(values, target, deadline, options \\ []),
    do: %__MODULE__{
      target: target,
      deadline: deadline,
      options: options,
      # What is set after it would be for a vehicle that is gone.
      left: Enum.sort_by(values, fn {name, _value, _type} -> SystemId.param?(name) end),
      total: length(values)
    }

  @doc "When `{:tick, now}` has to come, nil for never."
  @spec wake_at(t()) :: integer() | nil
  def wake_at(%{set: nil}), do: nil
  def wake_at(all), do: Set.wake_at(all.set)

  @spec handle(t(), Aerie.Control.Params.Fetch.Download.event()) ::
          {t(), [Aerie.Control.Params.Fetch.Download.action()]}
  def handle(%{set: nil} = all, {:start, now}), do: next(all, now)
  def handle(%{set: nil} = all, {:cancel, _now}), do: {all, [{:done, {:error, :cancelled}}]}
  def handle(%{set: nil} = all, _event), do: {all, []}

  def handle(all, event) do
    {set, actions} = Set.handle(all.set, event)

    case List.keytake(actions, :done, 0) do
      nil -> {%{all | set: set}, actions}
      {{:done, result}, actions} -> ended(all, result, actions, time(event))
    end
  end

  defp time(event), do: elem(event, tuple_size(event) - 1)

  defp ended(all, {:ok, _param}, actions, now), do: more(all, actions, now)

  defp ended(all, {:error, {kind, reason}}, actions, now) when kind in [:refused, :invalid],
    do: more(%{all | refused: [{all.set.name, reason} | all.refused]}, actions, now)

  defp ended(all, {:error, reason}, actions, _now),
    do: {%{all | set: nil}, actions ++ [{:done, {:error, reason}}]}

  defp more(all, actions, now) do
    all = %{all | done: all.done + 1, set: nil}
    {all, next} = next(all, now)
    {all, actions ++ [{:progress, all.done, all.total}] ++ next}
  end

  defp next(%{left: [{name, value, type} | left]} = all, now) do
    set = Set.new(name, value, all.target, all.deadline, [type: type] ++ all.options)
    {set, actions} = Set.handle(set, {:start, now})
    all = %{all | left: left, set: set}

    # If the type is known, an invalid value is found before anything is sent.
    case actions do
      [{:done, result}] -> ended(all, result, [], now)
      actions -> {all, actions}
    end
  end

  defp next(%{refused: []} = all, _now), do: {all, [{:done, {:ok, all.total}}]}

  defp next(%{refused: refused} = all, _now) do
    first = refused |> Enum.reverse() |> Enum.take(@shown)
    shown = Enum.map_join(first, "; ", fn {name, why} -> "#{name}: #{reason_text(why)}" end)

    {:failed, _text} = failed = Refusal.ended(:not_all_set, n: length(refused), of: all.total, shown: shown)
    {all, [{:done, {:error, failed}}]}
  end

  defp reason_text(reason) when is_binary(reason), do: reason
  defp reason_text(value), do: Refusal.text(:keeps_of_many, value: value)
end
