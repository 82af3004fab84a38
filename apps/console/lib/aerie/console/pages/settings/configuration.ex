defmodule Aerie.Console.Pages.Settings.Configuration do
  @moduledoc """
  The configuration that the gateway runs with, for admins to look at. What it is, only the app that read it knows: it gives
  `Aerie.Console.HTTP.Routes.serve/4` a function that says it in words, without any secret.
  """
  use Aerie.Console, :component

  alias Aerie.Base.Names

  @typedoc """
    * `:path` - as in the file: `http.port`
    * `:value`, `:default` - as text; a secret is \"set\" or \"not set\"
    * `:source` - the file, environment variable or command line that set it; nil for the default
    * `:unit` - nil where it has none
    * `:expected` - what a value must be, in words
  """
  @type key :: %{
          path: String.t(),
          value: String.t(),
          default: String.t(),
          source: String.t() | nil,
          unit: String.t() | nil,
          expected: String.t(),
          meaning: String.t()
        }
  @type section :: %{name: String.t(), meaning: String.t(), keys: [key()]}
  @type filter :: %{search: String.t(), given: boolean()}

  @doc "Shares the function under the name of the calling process, the console's supervisor."
  @spec share(Names.gateway(), (-> [section()]) | nil) :: :ok
  def share(gateway, configuration), do: Names.put_value(gateway, :console, configuration)

  @doc "The sections; `[]` where nobody gave them."
  @spec sections(Names.gateway()) :: [section()]
  def sections(gateway) do
    with configuration when configuration != nil <- Names.value(gateway, :console),
         do: configuration.(),
         else: (nil -> [])
  end

  @doc "The filter of a form."
  @spec filter(map()) :: filter()
  def filter(form),
    do: %{search: String.slice(form["search"] || "", 0, 60), given: form["given"] == "true"}

  @doc "The sections with the keys that a filter shows, without those that have none."
  @spec filtered([section()], filter()) :: [section()]
  def filtered(sections, %{search: search, given: given?}) do
    words = search |> String.downcase() |> String.split()

    for section <- sections,
        keys = Enum.filter(section.keys, &shown?(&1, words, given?)),
        keys != [],
        do: %{section | keys: keys}
  end

  defp shown?(key, words, given?) do
    text = String.downcase("#{key.path} #{key.meaning}")
    (not given? or key.source != nil) and Enum.all?(words, &String.contains?(text, &1))
  end

  attr :sections, :list, required: true, doc: "all of them"
  attr :filter, :map, required: true

  @doc "All keys that the filter shows."
  def configuration(assigns) do
    assigns = assign(assigns, :shown, filtered(assigns.sections, assigns.filter))

    ~H"""
    <section class="stack" aria-labelledby="configuration-title">
      <h2 id="configuration-title" class="visually-hidden">Configuration</h2>
      <p class="muted">
        The configuration in use. To change it, edit the file or the environment and restart the gateway. Links, clients, the policy and the log can
        be reloaded without a restart (<code>POST /api/config/reload</code>).
      </p>
      <form id="configuration-filter" class="form-row" phx-change="configuration" phx-submit="configuration">
        <.field id="configuration-search" name="search" type="search" label="Search" value={@filter.search} phx-debounce="150" autocomplete="off" />
        <.field id="configuration-given" name="given" type="checkbox" label="Only changed keys" value={@filter.given} />
      </form>
      <.empty :if={@shown == []} icon="search" title="No match" />
      <section :for={section <- @shown} :key={section.name} class="card" aria-labelledby={"section-#{section.name}"}>
        <h3 id={"section-#{section.name}"}>{section.name}</h3>
        <p :if={section.meaning != ""} class="muted">{section.meaning}</p>
        <.data_table id={"keys-of-#{section.name}"} label={"Keys of #{section.name}"} rows={section.keys} row_id={&"key-#{&1.path}"}>
          <:col :let={key} label="Key"><code>{key.path}</code></:col>
          <:col :let={key} label="Value"><strong class="mono">{key.value}</strong><span :if={key.unit} class="unit"> {key.unit}</span></:col>
          <:col :let={key} label="From">{from(key)}</:col>
          <:col :let={key} label="Meaning">{key.meaning} <span class="muted">{limits(key)}</span></:col>
        </.data_table>
      </section>
    </section>
    """
  end

  defp from(%{source: nil, value: same, default: same}), do: "default"
  defp from(%{source: nil}), do: "set at start"
  defp from(%{source: source}), do: source

  defp limits(%{source: nil, value: same, default: same} = key), do: "Must be #{key.expected}."
  defp limits(key), do: "Must be #{key.expected}. Default: #{key.default}."
end
