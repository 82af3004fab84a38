defmodule Aerie.Console.Pages.Fleet.Act.Sheet do
  @moduledoc """
  Something that several vehicles do together, as it is prepared: in an order, without those that are left out, with
  numbers within limits. Nothing is sent before the held press, and that carries all that was shown. Pure.

  A kind of sheet is a module with this behaviour, listed by its name in `Aerie.Console.Pages.Fleet.Act.Sheets`, which
  draws all of them. It declares:

    * `about/0`, `fields/0` and `rank/1`: its texts, its numbers and choices, and the order at first
    * `facts/4`: what it asks of a vehicle, by the functions of `Aerie.Console.Pages.Fleet.Act.Ask`; `:refusal` keeps
      one from beginning, `:snapshot` is there already
    * `line/4`: what is made of the facts; `:blocks` says why nothing begins with it, `:anyway?` offers to take it
      along although something is not known. `:id`, `:n` (its number from 1, nil if it is left out) are added. The map
      shows its number, its `:height` and its `:way`, the places to which it flies, and as bad what `:conflict?` says
    * `cells/1` and `summary/3`: how a line and all of them are shown; `against/3`: why they cannot begin together
    * `shown/2` and `request/2`: what of a line a press carries, and the operation that such a press asks for

  The page opens it by the event `sheet_NAME` with the vehicles of its button (`:of`).
  """

  alias Aerie.Console.Pages.Fleet.Act.Ask
  alias Aerie.Vehicle.Snapshot

  @enforce_keys [:kind, :order]
  defstruct [:kind, :order, :error, :own, values: %{}, out: MapSet.new(), anyway: MapSet.new()]

  @typedoc """
    * `:order` - the ids of all of them; `:out` - those that are left out; `:anyway` - those that are taken along
      although something is not known
    * `:values` - those fields that somebody has changed (`values/1` has all); `:error` - what is wrong with the others
    * `:own` - what a kind keeps beside them (`own/0`)
  """
  @type t :: %__MODULE__{
          kind: module(),
          order: [String.t()],
          out: MapSet.t(),
          anyway: MapSet.t(),
          values: values(),
          error: String.t() | nil,
          own: term()
        }
  @type values :: %{atom() => number() | String.t()}

  @typedoc """
  A number with its `:range`, or a choice with its `:options`. A default that is a function of the other values follows
  them until somebody changes it. `:only` - the value of another field with which it is shown.
  """
  @type field :: %{
          required(:name) => atom(),
          required(:label) => String.t(),
          required(:default) => number() | String.t() | (values() -> number()),
          optional(:range) => {number(), number()},
          optional(:unit) => String.t(),
          optional(:options) => [{label :: String.t(), value :: String.t()}],
          optional(:only) => {atom(), String.t()}
        }

  @typedoc """
    * `:id` - of the dialog; `:title` - before the number of vehicles; `:go` - on the button
    * `:in_turn?` - one after the other, in an order that can be changed; `:order` - what the order means
    * `:together?` - in that order, but at once
  """
  @type about :: %{
          required(:id) => String.t(),
          required(:title) => String.t(),
          required(:go) => String.t(),
          required(:icon) => String.t(),
          required(:order) => String.t(),
          required(:in_turn?) => boolean(),
          optional(:together?) => boolean()
        }

  @typedoc "What is known of a vehicle: `:snapshot`, `:refusal` (why the policy or the firmware refuses it), and more."
  @type facts :: %{:snapshot => Snapshot.t(), :refusal => String.t() | nil, optional(atom()) => term()}
  @type known :: %{String.t() => facts()}
  @type line :: map()

  @type cell ::
          {:text | :muted | :number, String.t() | nil}
          | {:readiness, atom()}
          | {:badges, [{kind :: String.t(), String.t() | nil}]}

  @callback about() :: about()
  @callback fields() :: [field()]
  @callback rank(Snapshot.t()) :: term()
  @callback facts(t(), Snapshot.t(), n :: non_neg_integer() | nil, Ask.t()) :: map()
  # `before`: those that go before it, the last one first.
  @callback line(
              t(),
              {id :: String.t(), n :: non_neg_integer() | nil},
              facts() | nil,
              before :: [{String.t(), facts()}]
            ) :: line()
  @callback cells(line()) :: [cell()]
  @callback summary(t(), [line()], known()) :: String.t() | [String.t() | nil]
  @callback shown(t(), line()) :: [term()]
  @callback request(shown :: map(), known()) :: map()
  @doc "Why these lines cannot begin together; nil if they can."
  @callback against(t(), going :: [line()], known()) :: String.t() | nil
  @doc "What is wrong with fields, by their names."
  @callback errors(values()) :: %{atom() => String.t()}
  @doc "What it keeps beside its values at first, and after an event of its own."
  @callback own() :: term()
  @callback event(t(), event :: String.t(), value :: map(), Ask.t()) :: t()
  @doc "What takes longer than a page may wait, done in a task: by which key its result is known, and the result."
  @callback work(t(), known()) :: {key :: term(), (Ask.t() -> result :: term())} | nil
  @callback worked(t(), key :: term(), result :: term()) :: t()
  @doc "What is known, with what was worked out."
  @callback known(t(), known()) :: known()
  @doc "What is done before the operation begins."
  @callback prepare(t(), shown :: map(), known(), Ask.t()) :: :ok | {:error, String.t()}
  @doc "What it has above the lines."
  @callback extra(assigns :: map()) :: Phoenix.LiveView.Rendered.t()
  @optional_callbacks against: 3,
                      errors: 1,
                      own: 0,
                      event: 4,
                      work: 2,
                      worked: 3,
                      known: 2,
                      prepare: 4,
                      extra: 1

  @most 100

  @doc "As many vehicles as a sheet takes."
  @spec most() :: pos_integer()
  def most, do: @most

  @doc "A sheet of a kind for these vehicles. What changes later changes no order."
  @spec new(module(), [Snapshot.t(), ...]) :: t()
  def new(kind, vehicles) do
    order = vehicles |> Enum.sort_by(&{kind.rank(&1), &1.id}) |> Enum.map(& &1.id)
    %__MODULE__{kind: kind, order: order, own: optional(kind, :own, [], nil)}
  end

  @doc "The values of all fields."
  @spec values(t()) :: values()
  def values(%{kind: kind, values: changed}) do
    {follow, plain} = Enum.split_with(kind.fields(), &is_function(&1.default))
    known = plain |> Map.new(&{&1.name, &1.default}) |> Map.merge(changed)
    Enum.reduce(follow, known, fn field, all -> Map.put_new(all, field.name, field.default.(known)) end)
  end

  @doc "The fields that are shown."
  @spec fields(t()) :: [field()]
  def fields(%{kind: kind} = sheet) do
    values = values(sheet)
    for field <- kind.fields(), {name, value} = field[:only] || {nil, nil}, values[name] == value, do: field
  end

  @doc "What is wrong with fields, by their names."
  @spec errors(t()) :: %{atom() => String.t()}
  def errors(%{kind: kind} = sheet) do
    values = values(sheet)
    optional(kind, :errors, [values], %{})
  end

  defp optional(kind, name, arguments, otherwise) do
    if function_exported?(kind, name, length(arguments)), do: apply(kind, name, arguments), else: otherwise
  end

  @doc "After an event of the page: its name without `sheet_`, and its value. One that does not fit changes nothing."
  @spec event(t(), event :: String.t(), value :: map(), Ask.t() | nil) :: t()
  def event(sheet, event, value, ask \\ nil)
  def event(sheet, "change", fields, _ask), do: change(sheet, fields)
  def event(sheet, "leave", %{"id" => id}, _ask), do: leave(sheet, id)

  def event(%{kind: kind} = sheet, "move", %{"id" => id, "to" => to}, _ask),
    do: if(kind.about().in_turn?, do: move(sheet, id, to), else: sheet)

  def event(sheet, "anyway", %{"id" => id}, _ask),
    do: if(id in sheet.order, do: %{sheet | anyway: MapSet.put(sheet.anyway, id)}, else: sheet)

  def event(%{kind: kind} = sheet, event, value, ask),
    do: optional(kind, :event, [sheet, event, value, ask], sheet)

  @doc "What has to be worked out in a task (`c:work/2`), nil for nothing."
  @spec work(t(), known()) :: {term(), (Ask.t() -> term())} | nil
  def work(%{kind: kind} = sheet, known), do: optional(kind, :work, [sheet, known], nil)

  @doc "With what was worked out."
  @spec worked(t(), key :: term(), result :: term()) :: t()
  def worked(%{kind: kind} = sheet, key, result), do: optional(kind, :worked, [sheet, key, result], sheet)

  @doc "Does what is needed before the operation that a press asks for."
  @spec prepare(t(), shown :: map(), known(), Ask.t()) :: :ok | {:error, String.t()}
  def prepare(%{kind: kind} = sheet, shown, known, ask),
    do: optional(kind, :prepare, [sheet, shown, known, ask], :ok)

  @doc "What a kind has above the lines, with their assigns; nil for nothing."
  @spec extra(t(), assigns :: map()) :: Phoenix.LiveView.Rendered.t() | nil
  def extra(%{kind: kind}, assigns), do: optional(kind, :extra, [assigns], nil)

  # A number beyond its limits, or another text, changes nothing and is said.
  defp change(%{kind: kind} = sheet, fields) do
    present = values(sheet)

    {values, wrong} =
      for field <- kind.fields(), text = fields[Atom.to_string(field.name)], reduce: {sheet.values, []} do
        {values, wrong} ->
          case read(field, text) do
            # A form has all its fields: one that was not changed goes on to follow the others.
            {:ok, value} when value == :erlang.map_get(field.name, present) -> {values, wrong}
            {:ok, value} -> {Map.put(values, field.name, value), wrong}
            {:error, text} -> {values, [text | wrong]}
            :ignore -> {values, wrong}
          end
      end

    %{sheet | values: values, error: if(wrong != [], do: Enum.join(wrong, "; "))}
  end

  defp read(%{options: options}, text),
    do: if(Enum.any?(options, fn {_label, value} -> value == text end), do: {:ok, text}, else: :ignore)

  defp read(%{name: name, range: {min, max}}, text) do
    with <<_::binary>> <- text,
         {number, ""} when number >= min and number <= max <- Float.parse(text) do
      {:ok, whole(Float.round(number, 1))}
    else
      _other -> {:error, "#{name}: expected a number from #{min} to #{max}"}
    end
  end

  defp whole(number) when trunc(number) == number, do: trunc(number)
  defp whole(number), do: number

  # To the place of another one, or by one place up or down.
  defp move(%{order: order} = sheet, id, to) do
    at = Enum.find_index(order, &(&1 == id))

    place =
      case to do
        "up" -> at && at - 1
        "down" -> at && at + 1
        other -> Enum.find_index(order, &(&1 == other))
      end

    if at == nil or place == nil or place < 0,
      do: sheet,
      else: %{sheet | order: order |> List.delete_at(at) |> List.insert_at(place, id)}
  end

  # Out, or along again.
  defp leave(%{out: out} = sheet, id) do
    cond do
      id not in sheet.order -> sheet
      MapSet.member?(out, id) -> %{sheet | out: MapSet.delete(out, id)}
      true -> %{sheet | out: MapSet.put(out, id), anyway: MapSet.delete(sheet.anyway, id)}
    end
  end

  @doc "What is known of those of its vehicles that are there."
  @spec facts(t(), (String.t() -> Snapshot.t() | nil), Ask.t()) :: known()
  def facts(%{kind: kind} = sheet, vehicle, ask) do
    known =
      for {id, n} <- places(sheet), snapshot = vehicle.(id), into: %{} do
        {id, sheet |> kind.facts(snapshot, n, ask) |> Map.put(:snapshot, snapshot)}
      end

    optional(kind, :known, [sheet, known], known)
  end

  # The vehicles in their order, each with how many go before it; nil for one that is left out.
  defp places(%{order: order, out: out}) do
    {places, _n} =
      Enum.map_reduce(order, 0, &if(MapSet.member?(out, &1), do: {{&1, nil}, &2}, else: {{&1, &2}, &2 + 1}))

    places
  end

  @doc "The lines in their order."
  @spec lines(t(), known()) :: [line()]
  def lines(%{kind: kind} = sheet, known) do
    {lines, _before} =
      Enum.map_reduce(places(sheet), [], fn {id, n} = place, before ->
        facts = known[id]
        line = kind.line(sheet, place, facts, before)
        line = Map.merge(line, %{id: id, n: n && n + 1, blocks: n && blocks(id, facts, line)})
        {line, if(n && facts, do: [{id, facts} | before], else: before)}
      end)

    lines
  end

  defp blocks(id, nil, _line), do: "#{id} is not known any more: leave it out."
  defp blocks(_id, _facts, %{blocks: <<_::binary>> = why}), do: why
  defp blocks(id, %{refusal: refusal}, _line), do: refusal && "#{id}: #{refusal}"

  defp going(lines), do: Enum.filter(lines, & &1.n)

  @doc "Why nothing can begin; nil if it can."
  @spec refusal(t(), known()) :: String.t() | nil
  def refusal(%{kind: kind} = sheet, known) do
    going = sheet |> lines(known) |> going()

    sheet.error || sheet |> errors() |> Map.values() |> List.first() ||
      if(going == [], do: "All are left out.") || Enum.find_value(going, & &1.blocks) ||
      optional(kind, :against, [sheet, going, known], nil)
  end

  @doc "What a press carries: all that it does, as the operator sees it."
  @spec shown(t(), known()) :: map()
  def shown(%{kind: kind} = sheet, known) do
    %{
      "sheet" => kind.about().id,
      "vehicles" => for(line <- sheet |> lines(known) |> going(), do: [line.id | kind.shown(sheet, line)]),
      "values" => for({name, value} <- values(sheet), into: %{}, do: {Atom.to_string(name), value})
    }
  end

  @doc "What the map shows of those that go, as far as their places are known (`map:preview`)."
  @spec preview(t(), known()) :: [map()]
  def preview(sheet, known) do
    for line <- sheet |> lines(known) |> going(),
        %{snapshot: snapshot} <- [known[line.id]],
        at = place(snapshot) do
      %{
        text: "#{line.n}#{if line[:height], do: ": #{line.height} m"}",
        way: for({lat, lon} <- [at | line[:way] || []], do: [lat, lon]),
        bad: line[:conflict?] == true or line.blocks != nil
      }
    end
  end

  @doc "Whether a press was made for what is shown now."
  @spec meant?(event :: map(), shown :: map()) :: boolean()
  def meant?(event, shown), do: Map.take(event, Map.keys(shown)) == shown

  @doc "The operation that a press with this id asks for."
  @spec request(t(), id :: String.t(), shown :: map(), known()) :: map()
  def request(%{kind: kind}, id, shown, known), do: shown |> kind.request(known) |> Map.put("id", id)

  @doc "A place of a snapshot's group, `:position` or `:home`; nil if it is not known."
  @spec place(Snapshot.t(), atom()) :: {number(), number()} | nil
  def place(snapshot, group \\ :position) do
    with %{lat: lat, lon: lon} when is_number(lat) and is_number(lon) <- Snapshot.data(snapshot, group),
         do: {lat, lon},
         else: (_unknown -> nil)
  end
end
