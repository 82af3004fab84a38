defmodule Phoenix.LiveViewTest.JavaScript do
  @moduledoc "Runs the scripts of `test/js` (`Aerie.Browser`), and serves what the pages of `Phoenix.LiveViewTest.Site` load."

  alias Aerie.Browser

  @scripts Path.expand("../js", __DIR__)

  @doc "Cowboy's routes for what a page of `Phoenix.LiveViewTest.Site` loads: the packages of npm and its own script."
  @spec routes() :: [tuple()]
  def routes do
    [
      {"/js/page.js", :cowboy_static, {:file, Path.join(@scripts, "page.js")}},
      {"/js/phoenix.mjs", :cowboy_static,
       {:file, Browser.package("phoenix/priv/static/phoenix.mjs"), javascript()}},
      {"/js/live_view.js", :cowboy_static,
       {:file, Browser.package("phoenix_live_view/priv/static/phoenix_live_view.esm.js"), javascript()}}
    ]
  end

  defp javascript, do: [{:mimetypes, {"text", "javascript", []}}]

  @doc "Runs a script: its output and exit status."
  @spec run(String.t(), [String.t()]) :: {String.t(), non_neg_integer()}
  def run(script, arguments), do: Browser.run(Path.join(@scripts, script), arguments)
end
