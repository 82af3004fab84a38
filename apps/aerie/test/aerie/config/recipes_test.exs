defmodule Aerie.Config.RecipesTest do
  @moduledoc "The pieces of configuration in docs/hub.md are ones that the gateway takes."
  use ExUnit.Case, async: true

  alias Aerie.Config
  alias Aerie.Router.Settings

  @moduletag :tmp_dir
  @guide Path.expand("../../../../../docs/hub.md", __DIR__)
  @external_resource @guide
  @recipes Regex.scan(~r/```yaml\n(.*?)```/s, File.read!(@guide), capture: :all_but_first) |> List.flatten()

  test "there are some" do
    assert length(@recipes) >= 8
  end

  for {recipe, n} <- Enum.with_index(@recipes, 1) do
    test "recipe #{n}", %{tmp_dir: dir} do
      path = Path.join(dir, "gateway.yaml")
      File.write!(path, unquote(recipe))
      assert {:ok, config} = Config.load(path, [], env: %{})
      for %{} = link <- config.links, do: assert({:ok, _options} = Settings.owner_options(link))
      clients = if config.clients == :default, do: [], else: config.clients
      for client <- clients, do: assert({:ok, _spec} = Aerie.Link.Clients.Settings.client(client))
    end
  end
end
