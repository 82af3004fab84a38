defmodule Aerie.Base.Settings do
  @moduledoc """
  The settings of one part of the gateway: each key of the configuration that the part reads, declared once, in the part's own
  folder. The declaration makes the part's struct, its defaults, its checks, and its lines of `config/gateway.example.yaml`.

      defmodule Camera.Recorder.Settings do
        use Aerie.Base.Settings

        section "recorder", "Recordings (tlog files) of links and vehicles."
        setting :dir, :path, "Folder.", default: "var/recordings"
        setting :after_ms, {:number, 0, 3600}, "How long …", key: "after_s", default: 30.0, times: 1000
      end

  `section` names the section of the configuration that the following keys are in (`""`: none); its meaning is given once, here
  or, of a section that several parts share, where the configuration is put together. The first argument of `setting` is the field of the struct,
  then follow type (`Aerie.Base.Settings.Field`), meaning and options:

    * `:key` - the key's name in the section, when it is not that of the field
    * `:default`, `:example`, `:required` - as for a field
    * `:times` - the struct has the value in another unit: times so much, as an integer
    * `:internal` - no key of the configuration, only something that tests change

  `part :identity, Camera.Identity.Settings` puts the settings of another part into a field.

  A part is started with its struct (`settings: %Camera.Recorder.Settings{}`) and sees nothing else of the configuration.
  The app on top reads files, the environment and the command line, and checks all sections at once; `from/1` then picks a part's settings from it. `new/1` checks the settings of one part by itself.
  """

  alias Aerie.Base.Settings.{Field, Schema}

  @typedoc "`key` as path; `field` as it is declared, its key being the last word of the path."
  @type setting :: %{
          name: atom(),
          path: [atom()],
          field: Field.t(),
          times: pos_integer() | nil,
          internal: boolean()
        }

  @doc "The settings in the order in which they are declared."
  @callback settings() :: [setting()]
  @doc "The sections that this part describes, by their keys."
  @callback sections() :: [{String.t(), String.t()}]
  @doc "Fills in what follows from other settings of the part."
  @callback derive(struct()) :: struct()

  @doc """
  What is wrong with the part's keys taken together: the whole configuration, every key with a value of its type and the
  derived values filled in.
  """
  @callback problems(config :: map()) :: [Schema.problem()]
  @doc "Warnings: values that are allowed but probably not meant."
  @callback warnings(config :: map()) :: [String.t()]

  defmacro __using__(_options) do
    for name <- [:aerie_settings, :aerie_sections, :aerie_parts],
        do: Module.register_attribute(__CALLER__.module, name, accumulate: true)

    quote do
      @behaviour Aerie.Base.Settings
      @before_compile Aerie.Base.Settings
      import Aerie.Base.Settings, only: [section: 1, section: 2, setting: 3, setting: 4, part: 2]
      import Aerie.Base.Settings.Field, only: [field: 3, field: 4, section: 3]

      @type t :: %__MODULE__{}

      @impl Aerie.Base.Settings
      def derive(settings), do: settings

      @impl Aerie.Base.Settings
      def problems(_config), do: []

      @impl Aerie.Base.Settings
      def warnings(_config), do: []

      defoverridable derive: 1, problems: 1, warnings: 1
    end
  end

  @doc "Names the section of the keys that follow, and says what it is about."
  defmacro section(key, doc \\ nil) do
    Module.put_attribute(__CALLER__.module, :aerie_section, key)
    if doc, do: Module.put_attribute(__CALLER__.module, :aerie_sections, {key, doc})
    nil
  end

  @doc "Declares a key. See the module's documentation."
  defmacro setting(name, type, doc, options \\ []) do
    section = Module.get_attribute(__CALLER__.module, :aerie_section) || ""

    # As code: types have functions in them, and defaults may come from elsewhere. It is evaluated when it is asked for.
    Module.put_attribute(__CALLER__.module, :aerie_settings, {name, {section, type, doc, options}})
    nil
  end

  @doc "Declares a field that holds the settings of another part."
  defmacro part(name, module) do
    Module.put_attribute(__CALLER__.module, :aerie_parts, {name, module})
    nil
  end

  defmacro __before_compile__(env) do
    [settings, sections, parts] =
      for name <- [:aerie_settings, :aerie_sections, :aerie_parts],
          do: env.module |> Module.get_attribute(name) |> Enum.reverse()

    declared =
      for {name, {section, type, doc, options}} <- settings do
        quote(
          do:
            Aerie.Base.Settings.declare(
              unquote(name),
              unquote(section),
              unquote(type),
              unquote(doc),
              unquote(options)
            )
        )
      end

    quote do
      defstruct unquote(Keyword.keys(settings) ++ Keyword.keys(parts))

      @impl Aerie.Base.Settings
      def settings, do: unquote(declared)

      @impl Aerie.Base.Settings
      def sections, do: unquote(sections)

      @doc false
      def parts, do: unquote(parts)

      @doc "The settings in a loaded configuration, or in any map with some of its keys; the others have their defaults."
      @spec from(map()) :: t()
      def from(config), do: Aerie.Base.Settings.from(__MODULE__, config)

      @doc "Checks a map as the configuration has it, with this part's keys: the settings, or every problem."
      @spec new(map()) :: {:ok, t()} | {:error, [Schema.problem()]}
      def new(raw \\ %{}), do: Aerie.Base.Settings.new(__MODULE__, raw)
    end
  end

  @doc false
  @spec declare(atom(), String.t(), Field.type(), String.t(), keyword()) :: setting()
  def declare(name, section, type, doc, options) do
    {own, options} = Keyword.split(options, [:key, :times, :internal])
    # Words of the program, none from outside.
    path =
      for word <- String.split("#{section}.#{own[:key] || name}", ".", trim: true), do: String.to_atom(word)

    field = Field.field(List.last(path), type, doc, options)
    %{name: name, path: path, field: field, times: own[:times], internal: own[:internal] == true}
  end

  @doc "See `c:settings/0`: the settings of a module, picked from a configuration that was checked."
  @spec from(module(), map()) :: struct()
  def from(module, config) do
    own = for setting <- module.settings(), do: {setting.name, pick(setting, config)}
    parts = for {name, part} <- module.parts(), do: {name, part.from(config)}
    module |> struct!(own ++ parts) |> module.derive()
  end

  @doc "The settings of a module from a map that nobody has checked: the struct, or every problem."
  @spec new(module(), map()) :: {:ok, struct()} | {:error, [Schema.problem()]}
  def new(module, raw) do
    case Schema.validate(fields(all(module)), Schema.plain(raw)) do
      {values, []} -> {:ok, from(module, values)}
      {_values, problems} -> {:error, problems}
    end
  end

  defp all(module), do: [module | for({_name, part} <- module.parts(), below <- all(part), do: below)]

  @doc """
  The schema that modules make together: the fields below their sections. `docs` describes sections that several share.
  The order is that of the modules; a section stands where its first key does.
  """
  @spec fields([module()], %{String.t() => String.t()}) :: [Field.t()]
  def fields(modules, docs \\ %{}) do
    docs = for module <- modules, {key, doc} <- module.sections(), into: docs, do: {key, doc}

    modules
    |> Enum.flat_map(& &1.settings())
    |> Enum.reject(& &1.internal)
    |> Enum.map(&{&1.path, &1.field})
    |> tree([], docs)
  end

  defp tree(leaves, above, docs) do
    leaves
    |> Enum.map(fn {[key | _], _field} -> key end)
    |> Enum.uniq()
    |> Enum.map(fn key ->
      case for({[^key | below], field} <- leaves, do: {below, field}) do
        [{[], field}] -> field
        below -> Field.section(key, Map.get(docs, name(above, key), ""), tree(below, above ++ [key], docs))
      end
    end)
  end

  defp name(above, key), do: Enum.join(above ++ [key], ".")

  defp pick(%{path: path, field: field, times: times}, config) do
    case at(config, path) do
      nil -> Schema.default(field)
      value -> complete(field.type, value)
    end
    |> in_units(times)
  end

  defp at(value, []), do: value
  defp at(%{} = map, [key | path]), do: map |> Map.get(key) |> at(path)
  defp at(_absent, _path), do: nil

  # Keys left out of a given section have their defaults.
  defp complete({:section, fields}, %{} = map) do
    given =
      for field <- fields,
          {:ok, value} when value != nil <- [Map.fetch(map, field.key)],
          into: %{},
          do: {field.key, complete(field.type, value)}

    fields |> Schema.defaults() |> Map.merge(given)
  end

  defp complete(_type, value), do: value

  defp in_units(value, times) when is_number(value) and times != nil, do: round(value * times)
  defp in_units(value, _times), do: value
end
