defmodule Aerie.Console.Commands.Batch do
  @moduledoc """
  One button press for several vehicles: a command for each, and its result. Pure.

  The id of each command is made from the id of the press, which the browser makes, and the vehicle's. So a press that
  arrives twice commands no vehicle twice.
  """

  alias Aerie.Console.Commands.{Entry, Submit}

  @types ~w(hold rtl land take_control release_control)

  @enforce_keys [:press, :type]
  defstruct [:press, :type, :fields, entries: []]

  @typedoc "`:waiting` is not submitted yet."
  @type state :: :waiting | Submit.state()
  @type entry :: %{vehicle: String.t(), id: String.t(), state: state()}
  @type t :: %__MODULE__{press: String.t(), type: String.t(), fields: term(), entries: [entry()]}

  @doc "The commands for the vehicles; `:error` for a command that this page does not offer, or an invalid id."
  @spec new(event :: map(), [String.t()]) :: {:ok, t()} | :error
  def new(%{"id" => press, "type" => type} = event, vehicles) when is_binary(press) and type in @types do
    if press =~ ~r/\A[A-Za-z0-9_-]{1,64}\z/ do
      entries = for vehicle <- vehicles, do: %{vehicle: vehicle, id: id(press, vehicle), state: :waiting}
      {:ok, %__MODULE__{press: press, type: type, fields: event["fields"], entries: entries}}
    else
      :error
    end
  end

  def new(_event, _vehicles), do: :error

  defp id(press, vehicle) do
    <<short::binary-18, _rest::binary>> = :crypto.hash(:sha256, [press, 0, vehicle])
    "web-" <> Base.url_encode64(short)
  end

  @doc "The next command to be submitted."
  @spec next(t()) :: entry() | nil
  def next(batch), do: Enum.find(batch.entries, &(&1.state == :waiting))

  @doc "The event of one of its commands, as a page for one vehicle has it (`Aerie.Console.Commands.Submit`)."
  @spec event(t(), entry()) :: map()
  def event(batch, entry), do: %{"id" => entry.id, "type" => batch.type, "fields" => batch.fields}

  @doc "Updates the state of a command. A result is final."
  @spec put(t(), id :: String.t(), state()) :: t()
  def put(batch, id, state) do
    entries =
      for entry <- batch.entries do
        if entry.id == id and not match?({:done, _, _}, entry.state), do: %{entry | state: state}, else: entry
      end

    %{batch | entries: entries}
  end

  @doc "The entry of a command."
  @spec find(t() | nil, id :: String.t()) :: entry() | nil
  def find(nil, _id), do: nil
  def find(batch, id), do: Enum.find(batch.entries, &(&1.id == id))

  @doc "How many commands have a result, and how many of these are not what was wanted."
  @spec count(t()) :: {over :: non_neg_integer(), not_done :: non_neg_integer()}
  def count(batch) do
    over = for %{state: {:done, status, _reason}} <- batch.entries, do: status
    {length(over), Enum.count(over, &(&1 not in [:completed, :accepted]))}
  end

  @doc "The commands and their results, those that need somebody first."
  @spec by_need(t()) :: [entry()]
  def by_need(batch), do: Enum.sort_by(batch.entries, &need(badge(batch.type, &1.state)))

  defp need({kind, _word}), do: Enum.find_index(~w(bad warn plain info ok), &(&1 == kind))

  @doc "The kind of badge and the word for the state of a command of a type."
  @spec badge(type :: String.t(), state()) :: {String.t(), String.t()}
  def badge(_type, :waiting), do: {"plain", "Waiting"}
  def badge(_type, :under_way), do: {"info", "Pending"}
  # A command is completed when the vehicle shows that it has begun.
  def badge("hold", {:done, :completed, _reason}), do: {"ok", "Holding"}
  def badge("rtl", {:done, :completed, _reason}), do: {"ok", "Returning"}
  def badge("land", {:done, :completed, _reason}), do: {"ok", "Landing"}

  def badge(_type, {:done, status, _text}) do
    {tone, word} = Entry.result(status)
    {Entry.badge(tone), word}
  end
end
