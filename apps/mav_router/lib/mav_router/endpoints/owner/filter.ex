defmodule MavRouter.Endpoints.Owner.Filter do
  @moduledoc """
  Which frames may come in from an endpoint, or go out to it: lists compiled to a few look-ups.

      {:ok, filter} = Filter.compile(%{block_messages: ["RAW_IMU"], allow_systems: [1, 2]})
      Filter.pass?(filter, frame, "radio-1")

  | key | passes |
  |---|---|
  | `allow_messages`, `block_messages` | by message name or id |
  | `allow_systems`, `block_systems` | by the source's system id |
  | `allow_components`, `block_components` | by the source's component id |
  | `allow_sources`, `block_sources` | by the link or client that it came from (outgoing filters) |

  A frame passes when, for messages, systems, components and sources alike, it is in the `allow` list, if there is one, and not in
  the `block` list. The empty filter is nil and costs nothing.
  """

  alias Aerie.Base.Json
  alias MavCodec.Frame

  @axes [:messages, :systems, :components, :sources]
  @keys for kind <- ["allow", "block"], axis <- @axes, do: :"#{kind}_#{axis}"

  @opaque compiled :: [{:id | :system | :component | :source, map | nil, map}]
  @type t :: compiled | nil
  @type spec :: %{optional(atom) => [String.t() | non_neg_integer]}

  @doc "The keys of a specification."
  @spec keys() :: [atom]
  def keys, do: @keys

  @doc "Compiles a specification; the error is a text. Keys that are left out, nil or empty pass everything."
  @spec compile(spec | nil) :: {:ok, t} | {:error, String.t()}
  def compile(nil), do: {:ok, nil}

  def compile(spec) when is_map(spec) do
    with :ok <- known(spec), {:ok, axes} <- axes(spec) do
      {:ok, if(axes == [], do: nil, else: axes)}
    end
  end

  def compile(other), do: {:error, "a filter is a map, not #{Json.shown(other, 60)}"}

  defp known(spec) do
    case Map.keys(spec) -- @keys do
      [] -> :ok
      [key | _] -> {:error, "#{Json.shown(key, 60)} is not a key of a filter"}
    end
  end

  defp axes(spec) do
    Enum.reduce_while(@axes, {:ok, []}, fn axis, {:ok, done} ->
      with {:ok, allow} <- set(axis, spec[:"allow_#{axis}"]),
           {:ok, block} <- set(axis, spec[:"block_#{axis}"]) do
        case {allow, block} do
          {nil, nil} -> {:cont, {:ok, done}}
          _some -> {:cont, {:ok, [{field(axis), allow, block || %{}} | done]}}
        end
      else
        error -> {:halt, error}
      end
    end)
  end

  defp field(:messages), do: :id
  defp field(:systems), do: :system
  defp field(:components), do: :component
  defp field(:sources), do: :source

  defp set(_axis, empty) when empty in [nil, []], do: {:ok, nil}

  defp set(axis, list) when is_list(list) do
    Enum.reduce_while(list, {:ok, %{}}, fn item, {:ok, set} ->
      case value(axis, item) do
        {:ok, value} -> {:cont, {:ok, Map.put(set, value, [])}}
        :error -> {:halt, {:error, "#{Json.shown(item, 60)} is not one of the #{axis}"}}
      end
    end)
  end

  defp set(axis, other), do: {:error, "#{axis}: expected a list, not #{Json.shown(other, 60)}"}

  defp value(:messages, item), do: message(item)
  defp value(:systems, n) when is_integer(n) and n in 0..0xFFFFFFFF, do: {:ok, n}
  defp value(:components, n) when is_integer(n) and n in 0..255, do: {:ok, n}
  defp value(:sources, text) when is_binary(text), do: {:ok, text}
  defp value(_axis, _item), do: :error

  @doc "The id of a message named by its name (any case) or its number."
  @spec message(String.t() | non_neg_integer) :: {:ok, non_neg_integer} | :error
  def message(id) when is_integer(id) and id in 0..0xFFFFFF, do: {:ok, id}

  def message(name) when is_binary(name) do
    with nil <- MavCodec.Dialects.All.message_id(String.upcase(name)),
         {id, ""} when id in 0..0xFFFFFF <- Integer.parse(name) do
      {:ok, id}
    else
      id when is_integer(id) -> {:ok, id}
      _none -> :error
    end
  end

  def message(_other), do: :error

  @doc "Whether a frame that came from the link or client `source` passes."
  @spec pass?(t, Frame.t(), String.t()) :: boolean
  def pass?(nil, _frame, _source), do: true
  def pass?([], _frame, _source), do: true

  def pass?([{field, allow, block} | rest], frame, source) do
    value = if field == :source, do: source, else: Map.fetch!(frame, field)

    (allow == nil or is_map_key(allow, value)) and not is_map_key(block, value) and
      pass?(rest, frame, source)
  end
end
