defmodule Aerie.Console.Pages.Fleet.Actions.Tagging do
  @moduledoc """
  The dialog for tags: of the vehicles that were selected when it was opened, whatever is selected later. Pure.
  """

  alias Aerie.Fleet.Shadow
  alias Aerie.Console.Pages.Fleet.Board.Row

  @enforce_keys [:ids, :common, :text]
  defstruct @enforce_keys ++ [error: nil, left: []]

  @typedoc """
  `:common` - the tags that all of them have; `:left` - vehicles that are still to be changed, with their new tags
  """
  @type t :: %__MODULE__{
          ids: [String.t()],
          common: [String.t()],
          text: String.t(),
          error: String.t() | nil,
          left: [{String.t(), [String.t()]}]
        }

  @doc "The form for these vehicles; nil for none."
  @spec new([Row.t()]) :: t() | nil
  def new([]), do: nil

  def new(rows) do
    common = rows |> Enum.map(&MapSet.new(&1.tags)) |> Enum.reduce(&MapSet.intersection/2) |> Enum.sort()
    %__MODULE__{ids: Enum.map(rows, & &1.id), common: common, text: Enum.join(common, ", ")}
  end

  @doc "Begins to change them. Tags that only some of the vehicles have stay theirs."
  @spec save(t(), text :: String.t(), [Row.t()]) :: t()
  def save(tagging, text, rows) do
    words = text |> String.split(",") |> Shadow.tidy_tags()
    left = for row <- rows, row.id in tagging.ids, do: {row.id, words ++ (row.tags -- tagging.common)}
    %{tagging | text: text, error: nil, left: left}
  end
end
