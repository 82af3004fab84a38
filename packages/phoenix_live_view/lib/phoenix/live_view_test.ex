defmodule Phoenix.LiveViewTest do
  @moduledoc """
  Tests pages without a browser: a page is fetched, joined and clicked, and read as HTML.

      conn = Phoenix.LiveViewTest.conn(server)
      {:ok, view, html} = live(conn, "/")
      assert html =~ "20 °C"
      assert view |> element("button", "up") |> render_click() =~ "21 °C"

  A view's messages pass through the wire encoding and are merged by rules that follow the client's.
  A value of `conn/2` takes the place of a `Plug.Conn`.
  """

  alias Phoenix.HTML.Safe
  alias Phoenix.LiveView.Server
  alias Phoenix.LiveView.View.Static
  alias Phoenix.LiveViewTest.{Client, DOM, Element, View}

  defmodule View do
    @moduledoc "A view that a test has joined."
    @enforce_keys [:pid, :client, :conn]
    defstruct [:pid, :client, :conn, :id]
    @type t :: %__MODULE__{}
  end

  defmodule Element do
    @moduledoc "An element of a view, found when it is used, by a selector and by its text."
    @enforce_keys [:view, :selector]
    defstruct [:view, :selector, :text, form: nil]
    @type t :: %__MODULE__{}
  end

  @type conn :: %{server: Server.t(), session: map()}

  @doc "A server and the session of the request."
  @spec conn(Server.t(), map()) :: conn()
  def conn(%Server{} = server, session \\ %{}), do: %{server: server, session: session}

  @doc "Fetches a page and joins it. `{:error, {:redirect, %{to, flash}}}` if it redirects."
  @spec live(conn(), String.t()) :: {:ok, View.t(), String.t()} | {:error, term()}
  def live(%{server: server} = conn, path) do
    uri = URI.merge("http://localhost", path)

    case Static.render(server, uri, info(conn)) do
      {:ok, html} ->
        html = IO.iodata_to_binary(html)
        [container] = html |> DOM.parse() |> DOM.all("[data-phx-main]")
        join(conn, container, %{"url" => URI.to_string(uri)})

      {:redirect, to, flash} ->
        {:error, {:redirect, %{to: to, flash: flash}}}

      {:refused, status} ->
        {:error, {:refused, status}}

      :not_found ->
        {:error, :not_found}
    end
  end

  defp join(conn, container, where) do
    payload =
      Map.merge(
        %{"session" => DOM.attribute(container, "data-phx-session"), "params" => %{"_mounts" => 0}},
        where
      )

    id = DOM.attribute(container, "id")

    case Client.start(owner: self(), server: conn.server, id: id, info: info(conn), payload: payload) do
      {:ok, client} ->
        view = %View{pid: Client.get(client, :channel), client: client, conn: conn, id: id}
        {:ok, view, render(view)}

      {:error, response} ->
        {:error, refused(conn, response)}
    end
  end

  defp info(conn), do: %{session: conn.session, csrf_token: "test"}

  defp refused(conn, response) do
    case Map.to_list(response) do
      [{kind, %{"to" => _} = target}] -> away(conn, {kind, target})
      _other -> response
    end
  end

  defp away(conn, {"redirect", %{"to" => to} = target}),
    do: {:redirect, %{to: to, flash: flash(conn, target["flash"])}}

  defp away(_conn, {kind, details}), do: {kind, details}

  defp flash(_conn, nil), do: %{}
  defp flash(conn, token), do: elem(Phoenix.LiveView.Token.verify(conn.server.secret, "flash", token, 60), 1)

  @doc "The page, or one element, as HTML."
  @spec render(View.t() | Element.t()) :: String.t() | {:error, term()}
  def render(%View{} = view) do
    case Client.html(view.client) do
      {:ok, html} -> html
      {:away, away} -> {:error, away(view.conn, away)}
    end
  end

  def render(%Element{} = element), do: element |> find!() |> DOM.html()

  @doc "An element of a view by selector, and by text in it."
  @spec element(View.t(), String.t(), String.t() | Regex.t() | nil) :: Element.t()
  def element(view, selector, text \\ nil), do: %Element{view: view, selector: selector, text: text}

  @doc "A form with values to fill in."
  @spec form(View.t(), String.t(), map() | keyword()) :: Element.t()
  def form(view, selector, data \\ %{}), do: %Element{view: view, selector: selector, form: data}

  @doc "Whether there is such an element."
  @spec has_element?(Element.t()) :: boolean()
  def has_element?(%Element{} = element), do: found(element) != []
  @spec has_element?(View.t(), String.t(), String.t() | Regex.t() | nil) :: boolean()
  def has_element?(view, selector, text \\ nil), do: view |> element(selector, text) |> has_element?()

  @doc "The title of the page."
  @spec page_title(View.t()) :: String.t() | nil
  def page_title(%View{} = view) do
    _ = render(view)
    Client.get(view.client, :title)
  end

  @doc "Clicks an element with `phx-click`, or a live link."
  def render_click(%Element{} = element), do: render_click(element, %{})

  @doc "Clicks an element, with more values; or sends a click's event to a view."
  def render_click(%Element{} = element, value) do
    node = find!(element)

    case {DOM.attribute(node, "phx-click"), DOM.attribute(node, "data-phx-link")} do
      {nil, "patch"} -> patch(element.view, DOM.attribute(node, "href"))
      {nil, "redirect"} -> {:error, {:live_redirect, %{to: DOM.attribute(node, "href"), flash: %{}}}}
      {nil, nil} -> raise ArgumentError, "no phx-click at #{DOM.html(node)}"
      {click, _link} -> click(element.view, click, node, value)
    end
  end

  def render_click(%View{} = view, event), do: event(view, "click", event, %{})

  @doc "Sends a click's event to a view."
  def render_click(%View{} = view, event, value), do: event(view, "click", event, value)

  defp patch(view, path) do
    url = view.client |> Client.get(:url) |> URI.merge(path) |> URI.to_string()
    rendered(view, push(view, "live_patch", %{url: url}))
  end

  # A click may run JS commands, of which only pushes reach the view.
  defp click(view, "[" <> _ = commands, node, value) do
    for(["push", %{"event" => event} = push] <- JSON.decode!(commands), do: {event, push["value"] || %{}})
    |> Enum.reduce(nil, fn {event, pushed}, _html ->
      event(view, "click", event, node |> values() |> Map.merge(pushed) |> Map.merge(string_keys(value)))
    end) || render(view)
  end

  defp click(view, event, node, value),
    do: event(view, "click", event, Map.merge(values(node), string_keys(value)))

  defp values({_tag, attributes, _children}) do
    given = for {"phx-value-" <> name, value} <- attributes, into: %{}, do: {name, value}

    case List.keyfind(attributes, "value", 0) do
      {_name, value} -> Map.put_new(given, "value", value)
      nil -> given
    end
  end

  @doc "Changes a form (`phx-change`) with the values of `form/3` and more."
  def render_change(%Element{} = element, value \\ %{}), do: submit(element, "phx-change", value)

  @doc "Submits a form (`phx-submit`) with the values of `form/3` and more."
  def render_submit(%Element{} = element, value \\ %{}), do: submit(element, "phx-submit", value)

  defp submit(%Element{form: data} = element, attribute, value) do
    node = find!(element)
    name = DOM.attribute(node, attribute) || raise ArgumentError, "no #{attribute} at #{DOM.html(node)}"
    given = pairs(data || %{}) ++ pairs(value)
    known = fields(node)

    for {field, _value} <- pairs(data || %{}), not List.keymember?(known, field, 0) do
      raise ArgumentError,
            "the form has no field #{inspect(field)}; it has #{inspect(Enum.map(known, &elem(&1, 0)))}"
    end

    names = MapSet.new(given, &elem(&1, 0))
    all = Enum.reject(known, fn {field, value} -> field in names or value == nil end) ++ given

    result =
      push(element.view, "event", %{type: "form", event: name, value: URI.encode_query(all), meta: %{}})

    rendered(element.view, result)
  end

  # The values that a browser would send for an untouched form; nil for those that it would leave out.
  defp fields(form) do
    form
    |> List.wrap()
    |> DOM.all("input[name], select[name], textarea[name]")
    |> Enum.map(fn {tag, _attributes, children} = node ->
      {DOM.attribute(node, "name"), field(tag, node, children)}
    end)
  end

  defp field("textarea", _node, children), do: DOM.text(children)

  defp field("select", _node, children) do
    options = DOM.all(children, "option")
    chosen = Enum.find(options, List.first(options), &DOM.attribute(&1, "selected"))
    chosen && (DOM.attribute(chosen, "value") || DOM.text(chosen))
  end

  defp field("input", node, _children) do
    if DOM.attribute(node, "type") in ["checkbox", "radio"] and DOM.attribute(node, "checked") == nil,
      do: nil,
      else: DOM.attribute(node, "value") || ""
  end

  defp pairs(data), do: Enum.flat_map(data, fn {key, value} -> pairs(to_string(key), value) end)

  defp pairs(name, %{} = fields),
    do: Enum.flat_map(fields, fn {key, value} -> pairs("#{name}[#{key}]", value) end)

  defp pairs(name, value), do: [{name, to_string(value)}]

  @doc "What a hook sends with `pushEvent`."
  def render_hook(%View{} = view, event, value \\ %{}), do: event(view, "hook", event, value)

  @doc "Waits until the view patches itself to this path."
  defmacro assert_patch(view, to, timeout \\ Application.fetch_env!(:ex_unit, :assert_receive_timeout)) do
    quote do
      view = unquote(view)
      to = unquote(to)
      client = view.client
      assert_receive {Phoenix.LiveViewTest.Client, ^client, :patch, ^to}, unquote(timeout)
      Phoenix.LiveViewTest.render(view)
    end
  end

  @doc "Waits until the view navigates elsewhere; `{kind, target}`."
  defmacro assert_redirect(view, to, timeout \\ Application.fetch_env!(:ex_unit, :assert_receive_timeout)) do
    quote do
      to = unquote(to)
      client = unquote(view).client
      assert_receive {Phoenix.LiveViewTest.Client, ^client, :away, {_kind, %{"to" => ^to}}}, unquote(timeout)
    end
  end

  @doc "Waits until the view sends its hooks an event; `payload` is a pattern for what it gave `Phoenix.LiveView.push_event/3`."
  defmacro assert_push_event(
             view,
             event,
             payload,
             timeout \\ Application.fetch_env!(:ex_unit, :assert_receive_timeout)
           ) do
    quote do
      client = unquote(view).client
      event = unquote(event)

      assert_receive {Phoenix.LiveViewTest.Client, ^client, :event, ^event, unquote(payload)},
                     unquote(timeout)
    end
  end

  @doc "The value of `~H` as HTML."
  @spec rendered_to_string(term()) :: String.t()
  def rendered_to_string(rendered), do: rendered |> Safe.to_iodata() |> IO.iodata_to_binary()

  defp event(view, type, event, value) do
    payload = %{type: type, event: to_string(event), value: string_keys(value)}
    rendered(view, push(view, "event", payload))
  end

  defp push(view, event, payload), do: Client.push(view.client, event, payload)

  defp rendered(view, :ok), do: render(view)

  defp rendered(view, {:away, {"crash", %{reason: reason}}}),
    do: exit({reason, {__MODULE__, :view, [view.id]}})

  defp rendered(view, {:away, away}), do: {:error, away(view.conn, away)}

  defp string_keys(value), do: Map.new(value, fn {key, value} -> {to_string(key), value} end)

  defp find!(%Element{selector: selector} = element) do
    case found(element) do
      [node] ->
        node

      [] ->
        raise ArgumentError, "no element fits #{inspect(selector)}#{with_text(element)} in: #{page(element)}"

      several ->
        raise ArgumentError, "#{length(several)} elements fit #{inspect(selector)}#{with_text(element)}"
    end
  end

  defp with_text(%{text: nil}), do: ""
  defp with_text(%{text: text}), do: " with #{inspect(text)}"

  defp page(element),
    do: with(html when is_binary(html) <- render(element.view), do: String.slice(html, 0, 2_000))

  defp found(%Element{view: view, selector: selector, text: text}) do
    case render(view) do
      html when is_binary(html) -> html |> DOM.parse() |> DOM.all(selector) |> Enum.filter(&says?(&1, text))
      {:error, away} -> raise ArgumentError, "the view is not there any more: #{inspect(away)}"
    end
  end

  defp says?(_node, nil), do: true
  defp says?(node, %Regex{} = text), do: DOM.text(node) =~ text
  defp says?(node, text), do: node |> DOM.text() |> String.contains?(text)
end
