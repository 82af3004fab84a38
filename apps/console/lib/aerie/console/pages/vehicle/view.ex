defmodule Aerie.Console.Pages.Vehicle.View do
  @moduledoc "A vehicle's snapshot at one time: its values as text with units, and their ages. Pure."

  alias Aerie.Vehicle.Snapshot

  @enforce_keys [:vehicle, :now, :silent_us]
  defstruct [:vehicle, :now, :silent_us]

  @typedoc "`:now` is the time that ages refer to (`Aerie.Vehicle.Snapshot.now/3`), `:silent_us` the time since the vehicle was heard."
  @type t :: %__MODULE__{vehicle: map(), now: integer(), silent_us: non_neg_integer() | nil}
  @type path :: [atom()]

  @fields for {group, _title, fields} <- Snapshot.groups(),
              field <- fields,
              into: %{},
              do: {[group | field.path], field}

  @fixes %{
    "NO_GPS" => "no GPS",
    "NO_FIX" => "no fix",
    "2D_FIX" => "2D",
    "3D_FIX" => "3D",
    "RTK_FLOAT" => "RTK float",
    "RTK_FIXED" => "RTK fixed"
  }

  @doc "The view of a snapshot, with the gateway's links (`Aerie.Base.Store.links/1`)."
  @spec new(map(), [map()], now :: integer()) :: t()
  def new(vehicle, links, now) do
    %__MODULE__{
      vehicle: vehicle,
      now: Snapshot.now(vehicle, links, now),
      silent_us: Snapshot.silent_us(vehicle, links, now)
    }
  end

  @doc "A value, such as `get(view, [:health, :ekf, :compass])`; nil if it is not known."
  @spec get(t(), path()) :: term()
  def get(%{vehicle: %{groups: groups}}, [group | path]) do
    Enum.reduce(path, groups[group][:data], fn
      name, %{} = data -> data[name]
      _name, _none -> nil
    end)
  end

  @doc "The age of a group's values in microseconds; nil without any."
  @spec age(t(), atom()) :: non_neg_integer() | nil
  def age(%{vehicle: %{groups: groups}, now: now}, group) do
    with %{at: at} <- groups[group], do: max(now - at, 0)
  end

  @doc "A value as text with its unit; ratios are per cent; `–` if it is not known. `changes` of the field, such as fewer `decimals`."
  @spec text(t(), path(), %{optional(:decimals) => non_neg_integer()}) :: String.t()
  def text(view, path, changes \\ %{})

  def text(view, [:gps, :fix_name] = path, _changes) do
    name = get(view, path)
    Map.get(@fixes, name, name || "–")
  end

  def text(view, path, changes) do
    field = Map.get(@fields, path, %{decimals: nil, unit: nil})
    format(get(view, path), Map.merge(field, changes))
  end

  defp format(nil, _field), do: "–"
  defp format(true, _field), do: "yes"
  defp format(false, _field), do: "no"
  defp format(number, %{unit: "0..1"}) when is_number(number), do: "#{round(number * 100)} %"
  defp format(number, %{unit: nil} = field) when is_number(number), do: number(number, field.decimals)
  defp format(number, field) when is_number(number), do: number(number, field.decimals) <> " " <> field.unit
  defp format(list, field) when is_list(list), do: Enum.map_join(list, ", ", &format(&1, field))
  defp format(text, _field) when is_binary(text), do: text
  defp format(other, _field) when is_atom(other), do: Atom.to_string(other)
  defp format(other, _field), do: inspect(other, limit: 10, printable_limit: 100)

  @doc "A number with a given number of decimals; `–` for nil."
  @spec number(number() | nil, non_neg_integer() | nil) :: String.t()
  def number(nil, _decimals), do: "–"
  def number(number, decimals) when decimals in [nil, 0], do: number |> round() |> Integer.to_string()

  # Adding 0.0 turns -0.0 into 0.0.
  def number(number, decimals),
    do: :erlang.float_to_binary(Float.round(number * 1.0, decimals) + 0.0, decimals: decimals)

  @doc "Problems in the vehicle's state, the worst first, in words."
  @spec warnings(t()) :: [{:bad | :warn, String.t()}]
  def warnings(view) do
    mode = get(view, [:mode]) || %{}

    [
      mode[:failsafe] && {:bad, "failsafe active (#{mode[:system_status]})"},
      get(view, [:mission, :fence_breach]) && {:bad, "outside its fence"},
      collision(view.vehicle.collision),
      battery(get(view, [:battery, :charge_state])),
      get(view, [:health, :rc_receiver]) == false && {:warn, "no remote control"}
    ]
    |> Enum.filter(& &1)
  end

  defp collision(nil), do: nil
  defp collision(%{sign: "claim"}), do: {:bad, "somebody else sends under this system id"}
  defp collision(_two), do: {:bad, "two vehicles use this system id"}

  defp battery(state) when state in ["CRITICAL", "EMERGENCY", "FAILED"],
    do: {:bad, "battery #{String.downcase(state)}"}

  defp battery(state) when state in ["LOW", "UNHEALTHY"], do: {:warn, "battery #{String.downcase(state)}"}
  defp battery(_state), do: nil
end
