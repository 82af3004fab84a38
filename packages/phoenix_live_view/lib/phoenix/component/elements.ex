defmodule Phoenix.Component.Elements do
  @moduledoc "Components that every page may use: links, forms, the title. Imported by `use Phoenix.Component`."

  # `use Phoenix.Component` imports this module, so it cannot be used here.
  import Phoenix.Component
  use Phoenix.Component.Declarative

  alias Phoenix.LiveView.Navigation

  attr :navigate, :string, default: nil
  attr :patch, :string, default: nil
  attr :href, :any, default: nil
  attr :replace, :boolean, default: false
  attr :rest, :global, include: ~w(download hreflang referrerpolicy rel target type)
  slot :inner_block, required: true

  @doc """
  A link: to another view (`navigate`), to another URL of this view (`patch`), or of any page (`href`).

  The value of an `href` may come from outside: everything except http, https, mailto, tel and paths is refused.
  """
  def link(%{navigate: to} = assigns) when is_binary(to) do
    ~H"""
    <a
      href={Navigation.href!(@navigate, "<.link navigate>")}
      data-phx-link="redirect"
      data-phx-link-state={if(@replace, do: "replace", else: "push")}
      {@rest}
    >{render_slot(@inner_block)}</a>
    """
  end

  def link(%{patch: to} = assigns) when is_binary(to) do
    ~H"""
    <a href={Navigation.href!(@patch, "<.link patch>")} data-phx-link="patch" data-phx-link-state={if(@replace, do: "replace", else: "push")} {@rest}>{render_slot(
      @inner_block
    )}</a>
    """
  end

  def link(assigns) do
    ~H"""
    <a href={destination(@href || "#")} {@rest}>{render_slot(@inner_block)}</a>
    """
  end

  defp destination(%URI{} = uri), do: uri |> URI.to_string() |> destination()

  defp destination(text) do
    case URI.new(text) do
      {:ok, %URI{scheme: scheme}} when scheme in [nil, "http", "https", "mailto", "tel"] -> text
      _other -> raise ArgumentError, "unsupported scheme given to <.link href>: #{inspect(text)}"
    end
  end

  attr :prefix, :string, default: nil
  attr :suffix, :string, default: nil
  attr :default, :string, default: nil
  slot :inner_block, required: true

  @doc "The title of the page; the client changes it when `page_title` is assigned."
  def live_title(assigns) do
    ~H"""
    <title data-prefix={@prefix} data-suffix={@suffix} data-default={@default}>{@prefix}{present(render_slot(@inner_block), @default)}{@suffix}</title>
    """
  end

  defp present(block, default) do
    text = block |> Phoenix.HTML.html_escape() |> Phoenix.HTML.safe_to_string() |> IO.iodata_to_binary()
    if String.trim(text) == "", do: default, else: block
  end

  attr :id, :string, required: true
  attr :rest, :global
  slot :inner_block, required: true

  @doc "Keeps the focus inside, for dialogs: Tab goes from the last element to the first."
  def focus_wrap(assigns) do
    ~H"""
    <div id={@id} phx-hook="Phoenix.FocusWrap" {@rest}>
      <div id={"#{@id}-start"} tabindex="0" aria-hidden="true"></div>
      {render_slot(@inner_block)}
      <div id={"#{@id}-end"} tabindex="0" aria-hidden="true"></div>
    </div>
    """
  end

  attr :for, :any, required: true
  attr :as, :any, default: nil
  attr :errors, :list, default: nil
  attr :action, :string, default: nil
  attr :method, :string, default: nil
  attr :csrf_token, :string, default: nil
  attr :rest, :global, include: ~w(autocomplete name novalidate)
  slot :inner_block, required: true

  @doc """
  A form from `to_form/2` or from params; `:let` is the `Phoenix.HTML.Form`.

  A form that the browser posts itself (`action`, `method="post"`) needs the page's `csrf_token`, which its root layout knows.
  """
  def form(assigns) do
    options = Enum.reject([as: assigns.as, errors: assigns.errors], fn {_key, value} -> value == nil end)
    assigns = assign(assigns, :form, to_form(assigns.for, options))

    ~H"""
    <form id={@form.id} action={@action} method={@method} {@form.options} {@rest}><input
        :if={@csrf_token}
        type="hidden"
        name="_csrf_token"
        value={@csrf_token}
      />{render_slot(@inner_block, @form)}</form>
    """
  end

  attr :tag_name, :string, required: true
  attr :rest, :global
  slot :inner_block

  @doc "An element whose name is known only at run time."
  def dynamic_tag(%{tag_name: name} = assigns) do
    if not (name =~ ~r/\A[a-z][a-z0-9-]*\z/),
      do: raise(ArgumentError, "expected the name of an element, got: #{inspect(name)}")

    assigns = assign(assigns, open: Phoenix.HTML.raw("<" <> name))
    attributes = Phoenix.HTML.attributes_escape(assigns.rest)
    empty? = assigns.inner_block == []
    close = if empty?, do: Phoenix.HTML.raw("/>"), else: Phoenix.HTML.raw("</" <> name <> ">")

    assigns =
      assign(assigns, attributes: attributes, gt: unless(empty?, do: Phoenix.HTML.raw(">")), close: close)

    ~H"{@open}{@attributes}{@gt}{render_slot(@inner_block)}{@close}"
  end

  attr :enum, :any, required: true
  slot :inner_block, required: true
  slot :separator, required: true

  @doc "Items with a separator between each two; `:let` is the item."
  def intersperse(assigns) do
    assigns = assign(assigns, :items, assigns.enum |> Enum.map(&{:item, &1}) |> Enum.intersperse(:separator))

    ~H"""
    {for item <- @items do
      if item == :separator, do: render_slot(@separator), else: render_slot(@inner_block, elem(item, 1))
    end
    |> nodes()}
    """
  end

  defp nodes(nodes), do: Phoenix.LiveView.Comprehension.new(["", ""], Enum.map(nodes, &{:index, [&1]}))
end
