defmodule Aerie.Console do
  @moduledoc """
  The console: pages for operators. `console/README.md` describes how it is put together.

      defmodule Aerie.Console.Pages.Links.Page do
        use Aerie.Console, {:page, events: [viewer: ~w(sort)], changes: [remove_link: ~w(remove)]}

        @impl Phoenix.LiveView
        def mount(_params, _session, socket), do: {:ok, socket |> subscribe([:links]) |> load()}

        @impl Phoenix.LiveView
        def handle_info(:refresh, socket), do: {:noreply, load(socket)}
      end

  A page gets the assigns `@gateway` (`t:Aerie.Base.Names.gateway/0`), `@user` (`t:Aerie.Control.Policy.Roles.source/0`), `@path` and `@alarms` before
  its `mount/3`. Its options:

    * `:role` - the least role that may open the page, `:viewer` unless given
    * `:changes` - events by the change of `Aerie.Access.Changes.Rights` that they cause, which says their least role
    * `:events` - the least role for other events by name. An event that is not named needs `:operator`

    * `:costly` - events that cost as much as several others: tables that are sorted, files that are read (`Aerie.Access.WorkLimit`)

  They are enforced in the server, before `mount/3` and before each `handle_event/3`.
  """

  alias Aerie.Control.Policy.Roles
  alias Aerie.Access.Changes.Rights

  @doc "`use Aerie.Console, :page`, `{:page, options}` or `:component`."
  defmacro __using__(:component), do: component()
  defmacro __using__(:page), do: page([])
  defmacro __using__({:page, options}), do: options |> Macro.expand_literals(__CALLER__) |> page()

  defp component do
    quote do
      use Phoenix.Component
      use Aerie.Console.UI
      alias Phoenix.LiveView.JS
    end
  end

  defp page(options) do
    quote do
      use Phoenix.LiveView
      use Aerie.Console.UI
      import Aerie.Console.Refresh, only: [subscribe: 1, subscribe: 2]
      alias Phoenix.LiveView.JS

      @doc false
      def __console__, do: unquote(__MODULE__).options(unquote(options))
    end
  end

  @doc false
  @spec options(keyword()) :: %{
          role: Roles.role(),
          events: %{String.t() => Roles.role()},
          costly: [String.t()]
        }
  def options(options) do
    options = Keyword.validate!(options, role: :viewer, events: [], changes: [], costly: [])
    events = for {role, names} <- options[:events], name <- names, into: %{}, do: {name, role}

    changes =
      for {change, names} <- options[:changes],
          role = Map.fetch!(Rights.all(), change),
          name <- names,
          into: %{},
          do: {name, role}

    # Every page answers the palette (`Aerie.Console.Frame`).
    events = events |> Map.merge(changes) |> Map.put("palette", :viewer)
    %{role: options[:role], events: events, costly: options[:costly]}
  end
end
