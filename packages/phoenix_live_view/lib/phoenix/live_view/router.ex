defmodule Phoenix.LiveView.Router do
  @moduledoc """
  Maps paths to views.

      defmodule Routes do
        use Phoenix.Router
        import Phoenix.LiveView.Router

        live_session :operators, on_mount: [Guard] do
          live "/", FleetLive
          live "/vehicles/:id", VehicleLive
        end
      end

  Navigation within one `live_session` loads no new page; between sessions the page is loaded again. `match/2` finds the
  route of a path; segments with a colon become parameters.
  """

  defmodule Route do
    @moduledoc "A route: its view, the `live_session` that it belongs to, and the parameters of the path."
    @enforce_keys [:view, :segments]
    defstruct [:view, :segments, session: %{name: :default, on_mount: [], layout: nil}, params: %{}]

    @type t :: %__MODULE__{}
  end

  @doc "A view at a path."
  defmacro live(path, view) do
    # Expanded as if in a function, so that the router is not recompiled whenever the view is.
    view = Macro.expand_literals(view, %{__CALLER__ | function: {:__live_routes__, 0}})

    quote bind_quoted: [path: path, view: view] do
      @live_routes %Phoenix.LiveView.Router.Route{
        view: view,
        segments: Phoenix.LiveView.Router.segments(path),
        session: @live_session
      }
    end
  end

  @doc """
  Routes that share hooks and a layout. Options: `:on_mount`, modules; `:layout`, `{module, name}` of the component around each page.
  """
  defmacro live_session(name, options \\ [], do: block) do
    quote do
      @live_session Phoenix.LiveView.Router.session(unquote(name), unquote(Keyword.delete(options, :do)))
      unquote(block)
      @live_session %{name: :default, on_mount: [], layout: nil}
    end
  end

  @doc false
  def session(name, options) do
    case Keyword.keys(options) -- [:on_mount, :layout] do
      [] -> :ok
      unknown -> raise ArgumentError, "unknown options of live_session: #{inspect(unknown)}"
    end

    %{
      name: name,
      on_mount:
        options
        |> Keyword.get(:on_mount, [])
        |> List.wrap()
        |> Enum.map(&Phoenix.LiveView.View.Lifecycle.on_mount/1),
      layout: options[:layout]
    }
  end

  @doc "The segments of a path."
  @spec segments(String.t()) :: [String.t()]
  def segments(path), do: String.split(path, "/", trim: true)

  @doc "The route of a path with its decoded parameters; `:error` if there is none."
  @spec match(module(), String.t()) :: {:ok, Route.t()} | :error
  def match(router, path) do
    segments = segments(path)

    Enum.find_value(router.__live_routes__(), :error, fn route ->
      with {:ok, params} <- fits(route.segments, segments, %{}),
           do: {:ok, %{route | params: params}},
           else: (:error -> nil)
    end)
  end

  defp fits([], [], params), do: {:ok, params}

  defp fits([":" <> name | pattern], [segment | path], params) do
    with {:ok, value} <- decoded(segment), do: fits(pattern, path, Map.put(params, name, value))
  end

  defp fits([same | pattern], [same | path], params), do: fits(pattern, path, params)
  defp fits(_pattern, _path, _params), do: :error

  defp decoded(segment) do
    value = URI.decode(segment)
    if String.valid?(value), do: {:ok, value}, else: :error
  rescue
    ArgumentError -> :error
  end
end
