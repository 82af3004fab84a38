defmodule Aerie.Console.Layout do
  @moduledoc "The frame of every page: the document, and in it the header, the navigation and messages."
  use Aerie.Console, :component

  alias Aerie.Console.Assets

  @doc """
  The document. The banner for a lost gateway is outside the live page, because it shows when that is dead. Until the page is live, all its
  buttons and fields are disabled, because nothing would answer them (`assets/lib/gateway.js` enables them); its links work.
  """
  def root(assigns) do
    assigns = Map.merge(%{theme: nil, live: true, page_title: nil}, assigns)

    ~H"""
    <html lang="en" data-theme={@theme} class={@live && "connecting"}>
      <head>
        <meta charset="utf-8" />
        <meta name="viewport" content="width=device-width, initial-scale=1, viewport-fit=cover" />
        <meta name="csrf-token" content={@csrf_token} />
        <meta name="color-scheme" content="dark light" />
        <.live_title default="Aerie" suffix=" · Aerie">{@page_title}</.live_title>
        <link rel="icon" href={Assets.path(@gateway, "icon.svg")} type="image/svg+xml" />
        <link rel="preload" href={Assets.path(@gateway, Assets.font())} as="font" type="font/woff2" crossorigin />
        <link :for={style <- Assets.styles(@gateway)} rel="stylesheet" href={Assets.path(@gateway, style)} phx-track-static />
        <script :if={@live} type="module" src={Assets.path(@gateway, "console.js")} phx-track-static></script>
      </head>
      <body>
        <a class="skip" href="#main">Skip to the content</a>
        <a class="skip to-table" href="#main" data-action="table">To the table</a>
        <a class="skip to-actions" href="#main" data-action="actions">To the actions</a>
        <div id="gateway-lost" class="banner bad" role="alert" hidden>
          <.icon name="link-off" /> <strong>Gateway lost.</strong>
          <span>What you see is <b id="gateway-lost-age"></b> old. Commands are off. Reconnecting…</span>
        </div>
        <div :if={Assets.missing(@gateway) != []} class="banner bad" role="alert">
          The pages' JavaScript packages are not installed: run <code>bin/setup</code> and start the gateway again.
        </div>
        <noscript><div class="banner bad">The console needs JavaScript.</div></noscript>
        <.content live={@live}>{@inner_content}</.content>
        <p id="hint" class="toast" role="status" hidden></p>
      </body>
    </html>
    """
  end

  attr :live, :boolean, required: true
  slot :inner_block, required: true

  defp content(%{live: false} = assigns), do: ~H"{render_slot(@inner_block)}"

  defp content(assigns),
    do: ~H[<fieldset id="controls" role="presentation" disabled>{render_slot(@inner_block)}</fieldset>]

  @doc "The page for an unknown address."
  @spec not_found() :: String.t()
  def not_found do
    """
    <!DOCTYPE html>
    <html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1"><title>Not found · Aerie</title></head>
    <body><h1>Not found</h1><p>There is no such page. <a href="/">To the fleet</a></p></body></html>
    """
  end

  @doc "The page for somebody who has opened too many at once."
  @spec too_many() :: String.t()
  def too_many do
    """
    <!DOCTYPE html>
    <html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1"><title>Too many requests · Aerie</title></head>
    <body><h1>Too many pages at once</h1><p>Wait a moment, and then load <a href="/">the fleet</a>.</p></body></html>
    """
  end

  @doc "Header, navigation (`Aerie.Console.Frame`) and messages around a page."
  def app(assigns) do
    ~H"""
    <div id="app" class="app">
      <header class="top">
        <.link navigate="/" class="brand" aria-label="Aerie, to the fleet"><.logo /><span>Aerie</span></.link>
        <p :if={@connecting} class="badge warn" role="status">Connecting…, values of {@connecting}</p>
        {@alarm_strip}
        {@abort_all}
        <span id="clock" class="clock wide-only" title="All times are UTC">{@clock}</span>
        <details class="menu" id="user-menu" phx-mounted={JS.ignore_attributes("open")}>
          <summary aria-label={"#{@user.name}, #{@user.role}: account and look"}>
            <.icon name="user" /><span class="wide-only">{@user.name}</span>
            <.badge :if={@user.role == :viewer}>viewer</.badge><.icon name="chevron-down" />
          </summary>
          <div class="menu-list">
            <p class="menu-head">{@user.name} <.badge>{@user.role}</.badge> <span class="clock phone-only">{@clock}</span></p>
            {@frame.menu}
          </div>
        </details>
      </header>
      {@frame.nav}
      <main id="main" class="main" tabindex="-1">{@inner_content}</main>
      {@operation_strip}
      <.flash flash={@flash} />
      {@frame.help}
    </div>
    """
  end
end
