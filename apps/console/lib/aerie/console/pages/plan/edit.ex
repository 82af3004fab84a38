defmodule Aerie.Console.Pages.Plan.Edit do
  @moduledoc "Converts what a browser sends about a plan into arguments for `Aerie.Console.Pages.Plan.Draft`. Pure; no input is trusted."

  alias Protocols.Mission.Item
  alias Aerie.Console.Pages.Plan.{Draft, Kinds}

  @parts %{"mission" => :mission, "fence" => :fence, "rally" => :rally}
  @targets Map.put(@parts, "home", :home)
  @shapes %{
    "inclusion polygon" => {:inclusion, :polygon},
    "inclusion circle" => {:inclusion, :circle},
    "exclusion polygon" => {:exclusion, :polygon},
    "exclusion circle" => {:exclusion, :circle}
  }
  # Frames: above home, above mean sea level, above the ground.
  @frames %{"3" => 3, "0" => 0, "10" => 10}
  @transfers %{"upload" => :upload, "download" => :download, "verify" => :verify}

  @doc "The zones that a click can create, for a select."
  @spec shapes() :: [{String.t(), String.t()}]
  def shapes do
    [
      {"Stay inside a polygon", "inclusion polygon"},
      {"Stay inside a circle", "inclusion circle"},
      {"Keep out of a polygon", "exclusion polygon"},
      {"Keep out of a circle", "exclusion circle"}
    ]
  end

  @doc "The value in `shapes/0` of a zone's kind and shape."
  @spec shape({atom(), atom()}) :: String.t()
  def shape(shape), do: Enum.find_value(@shapes, fn {name, one} -> if one == shape, do: name end)

  @doc "The references of heights, for a select."
  @spec frames() :: [{String.t(), String.t()}]
  def frames, do: [{"above home", "3"}, {"above sea level", "0"}, {"above ground", "10"}]

  @doc "The part with a name."
  @spec part(term()) :: {:ok, Draft.part()} | :error
  def part(name), do: Map.fetch(@parts, name)

  @doc "The action with a name that was checked."
  @spec transfer(String.t()) :: :upload | :download | :verify
  def transfer(name), do: Map.fetch!(@transfers, name)

  @doc "The position of an event; `Draft` reports invalid ones."
  @spec place(map()) :: Draft.place() | {term(), term()}
  def place(value), do: {value["lat"], value["lon"]}

  @doc "The target of an event: `part`, `index`, and for zones `corner`."
  @spec target(map()) :: {:ok, Draft.target()} | :error
  def target(value) do
    with {:ok, part} <- Map.fetch(@targets, value["part"]),
         {:ok, index} <- index(value["index"]),
         {:ok, corner} <- corner(value["corner"]),
         do: {:ok, {part, index, corner}}
  end

  defp corner(none) when none in [nil, ""], do: {:ok, nil}
  defp corner(value), do: index(value)

  @doc "An index, counted from 0."
  @spec index(term()) :: {:ok, non_neg_integer()} | :error
  def index(n) when is_integer(n) and n in 0..10_000, do: {:ok, n}

  def index(text) when is_binary(text) and byte_size(text) <= 5 do
    case Integer.parse(text) do
      {n, ""} when n >= 0 -> {:ok, n}
      _other -> :error
    end
  end

  def index(_other), do: :error

  @doc "The number in a field."
  @spec number(term()) :: {:ok, float()} | :error
  def number(text) when is_binary(text) and byte_size(text) <= 40 do
    case Float.parse(String.trim(text)) do
      {number, ""} -> {:ok, number}
      _other -> :error
    end
  end

  def number(_other), do: :error

  @doc "The number, or 0."
  @spec or_zero(term()) :: number()
  def or_zero(number) when is_number(number), do: number
  def or_zero(_unknown), do: 0.0

  @doc "Sets what a click on the map adds."
  @spec what(map(), map()) :: map()
  def what(what, %{"command" => command}) do
    case Kinds.parse(command) do
      {:ok, command} -> %{what | mission: command}
      :error -> what
    end
  end

  def what(what, %{"shape" => shape}), do: %{what | fence: Map.get(@shapes, shape, what.fence)}
  def what(what, _other), do: what

  @doc """
  The fields of a form: `part` and `index`; for an item `command`, `frame`, `z` and `p1` to `p4`; for a zone `kind` and `radius`; for a
  rally point `z`; `lat` and `lon` for everything with a single position. An empty parameter is "unset".
  """
  @spec set(Draft.t(), map()) :: Draft.result()
  def set(draft, %{"part" => "mission"} = value) do
    with {:ok, index} <- found(value),
         {:ok, item} <- item(draft, index),
         {:ok, draft} <- Draft.set_item(draft, index, changes(item, value)),
         {:ok, item} <- item(draft, index) do
      # The form may still have the position of the previous kind.
      if Item.place?(item.command, item.frame),
        do: place(draft, {:mission, index, nil}, value),
        else: {:ok, draft}
    end
  end

  def set(draft, %{"part" => "fence"} = value) do
    kind = %{"inclusion" => :inclusion, "exclusion" => :exclusion}[value["kind"]]
    changes = if kind, do: %{kind: kind}, else: %{}

    with {:ok, index} <- found(value),
         {:ok, changes} <- radius(changes, value["radius"]),
         do: Draft.set_zone(draft, index, changes)
  end

  def set(draft, %{"part" => "rally"} = value) do
    with {:ok, index} <- found(value),
         {:ok, altitude} <- required(value["z"], "height"),
         {:ok, draft} <- Draft.set_rally(draft, index, altitude),
         do: place(draft, {:rally, index, nil}, value)
  end

  def set(draft, _other), do: {:ok, draft}

  defp found(value),
    do: with(:error <- index(value["index"]), do: {:error, "index: expected a number from 0"})

  defp item(draft, index) do
    case Enum.at(draft.plan.items, index) do
      nil -> {:error, "there is no such item"}
      item -> {:ok, item}
    end
  end

  defp changes(item, value) do
    {:ok, command} = with :error <- Kinds.parse(value["command"]), do: {:ok, item.command}
    params = if command == item.command, do: item.params, else: Kinds.item(command).params

    # The fields belong to the item's previous kind.
    params =
      for n <- 1..4 do
        old = elem(params, n - 1)
        if command == item.command, do: optional(value["p#{n}"], old), else: old
      end

    frame = Map.get(@frames, value["frame"], item.frame)

    %{
      command: command,
      frame: frame,
      z: optional(value["z"], item.z),
      params: List.to_tuple(params)
    }
    |> Map.merge(moved(item, command, frame))
  end

  # A position means nothing to a kind that has none, and the other way round.
  defp moved(%{command: command}, command, _frame), do: %{}

  defp moved(item, command, frame) do
    if Item.place?(command, frame) and Item.place?(item.command, item.frame),
      do: %{},
      else: Map.take(Kinds.item(command), [:x, :y])
  end

  defp optional(nil, old), do: old
  defp optional("", _old), do: nil

  defp optional(text, old) do
    case number(text) do
      {:ok, number} -> number
      :error -> old
    end
  end

  defp radius(changes, nil), do: {:ok, changes}

  defp radius(changes, text),
    do: with({:ok, metres} <- required(text, "radius"), do: {:ok, Map.put(changes, :radius, metres)})

  defp required(text, name), do: with(:error <- number(text), do: {:error, "#{name}: expected a number"})

  defp place(draft, target, %{"lat" => lat, "lon" => lon}) do
    with {:ok, lat} <- required(lat, "latitude"), {:ok, lon} <- required(lon, "longitude") do
      if same?(draft, target, {lat, lon}), do: {:ok, draft}, else: Draft.move(draft, target, {lat, lon})
    end
  end

  defp place(draft, _target, _value), do: {:ok, draft}

  # A field shows six decimals; if it is unchanged, the position must not move.
  defp same?(draft, target, {lat, lon}) do
    {x, y} =
      case target do
        {:mission, n, _} -> draft.plan.items |> Enum.at(n) |> then(&{&1.x, &1.y})
        {:rally, n, _} -> draft.plan.rally |> Enum.at(n) |> elem(0)
      end

    is_integer(x) and is_integer(y) and abs(x / 1.0e7 - lat) < 1.0e-6 and abs(y / 1.0e7 - lon) < 1.0e-6
  end
end
