defmodule Mix.Tasks.Aerie.Authority do
  @shortdoc "Renews the tables of docs/policy.md and docs/security.md"
  @moduledoc """
  Renews the tables that say who can do what (`Aerie.Control.Policy.Roles.Page`).

      mix aerie.authority
  """
  use Mix.Task

  alias Aerie.Vehicle.Command.Page, as: Markdown
  alias Aerie.Control.Policy.Roles.Page

  @docs Path.expand("../../../../../docs", __DIR__)

  @doc "The pages as they are to be, by their files."
  @spec pages() :: %{Path.t() => String.t()}
  def pages do
    for {name, sections} <- [{"policy.md", Page.sections()}, {"security.md", %{"ways" => Page.ways()}}],
        into: %{} do
      file = Path.join(@docs, name)
      {file, Markdown.renew(File.read!(file), sections)}
    end
  end

  @impl Mix.Task
  def run(_args) do
    for {file, page} <- pages() do
      File.write!(file, page)
      Mix.shell().info("wrote #{Path.relative_to_cwd(file)}")
    end
  end
end
