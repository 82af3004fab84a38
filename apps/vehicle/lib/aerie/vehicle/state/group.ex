defmodule Aerie.Vehicle.State.Group do
  @moduledoc """
  A group of a vehicle's state, as its module declares it with `use Aerie.Vehicle.State.Group`.

    * `fields` - `{name, type, unit, meaning, source}`, or with the least and largest value, `{0, nil}` or `0..360`,
      and the name and help of a metric (`[range: …, metric: {…, …}]`); a list of names for a nested field. The type
      is a number of decimals (0 for whole numbers), `:text`, `:boolean`, `:time`, `{:one_of, texts}`, `{:list,
      type}`, `{:list, :object}` and `{:object, decimals}` of the fields below it, `{:list, :group}` of these and the
      group's own
    * `sampling` - how it is published unless the configuration says otherwise: `{strategy, hz, threshold, refresh_s}`
      (`Aerie.Vehicle.State.Sampling`)
    * `messages` - the messages that the module reads, whichever groups they change. `{second, first}`: the second is
      read only while the first has not come for two seconds
  """

  alias Aerie.Vehicle.State

  @enforce_keys [:name, :title, :sampling, :messages, :fields]
  defstruct @enforce_keys

  @type kind ::
          non_neg_integer()
          | :text
          | :boolean
          | :time
          | {:one_of, [String.t()]}
          | {:list, kind() | :object | :group}
          | {:object, non_neg_integer()}
  @typedoc "`path`: its name, or the names that lead to it. `decimals`: 0 for whole numbers, nil for others than numbers."
  @type field :: %{
          path: [atom()],
          type: kind(),
          range: {number() | nil, number() | nil},
          decimals: non_neg_integer() | nil,
          unit: String.t() | nil,
          meaning: String.t(),
          source: String.t(),
          metric: {name :: String.t(), help :: String.t()} | nil
        }
  @type t :: %__MODULE__{
          name: State.group(),
          title: String.t(),
          sampling: {atom(), float(), %{String.t() => number()}, float()},
          messages: [module() | {second :: module(), first :: module()}],
          fields: [field()]
        }

  @typedoc "What a message says: fields of the state's struct, and changes of groups."
  @type said :: {fields :: keyword(), changes :: [{State.group(), map()}]} | {:invalid, atom()}

  @doc "The group."
  @callback group() :: t()
  @doc "Reads one of its messages, given the state so far."
  @callback read(message :: struct(), State.t(), at :: integer()) :: said()
  @optional_callbacks group: 0, read: 3

  @doc false
  defmacro __using__(group) do
    quote do
      @behaviour unquote(__MODULE__)
      @group unquote(__MODULE__).new(unquote(group))

      @doc false
      @impl unquote(__MODULE__)
      def group, do: @group
    end
  end

  @doc false
  @spec new(keyword()) :: t()
  def new(group) do
    struct!(__MODULE__, Keyword.put(group, :fields, Enum.map(group[:fields], &field/1)))
  end

  defp field({path, type, unit, meaning, source}), do: field({path, type, unit, meaning, source, []})

  defp field({path, type, unit, meaning, source, options}) do
    options = if is_list(options), do: options, else: [range: options]
    # A ratio is 0..1, whatever is measured.
    range = Keyword.get(options, :range, if(unit == "0..1", do: 0..1, else: {nil, nil}))

    %{
      path: List.wrap(path),
      type: type,
      range: with(first..last//_step <- range, do: {first, last}),
      metric: options[:metric],
      decimals: decimals(type),
      unit: unit,
      meaning: meaning,
      source: source
    }
  end

  defp decimals(n) when is_integer(n), do: n
  defp decimals({_several, n}) when is_integer(n), do: n
  defp decimals(_no_number), do: nil

  @doc "The data of a group so far; empty before its first message."
  @spec data(State.t(), State.group()) :: map()
  def data(%{groups: groups}, name) do
    case groups do
      %{^name => %{data: data}} -> data
      _unheard -> %{}
    end
  end
end
