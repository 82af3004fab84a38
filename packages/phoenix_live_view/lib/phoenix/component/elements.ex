defmodule Phoenix.Component.Elements do
  @moduledoc "Components that every page may use: links, the title. Imported by `use Phoenix.Component`."

  # `use Phoenix.Component` imports this module, so it cannot be used here.
  import Phoenix.Component
  use Phoenix.Component.Declarative

  alias Phoenix.LiveView.View.Navigation

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
end
