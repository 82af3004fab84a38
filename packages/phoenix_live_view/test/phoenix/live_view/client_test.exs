defmodule Phoenix.LiveView.ClientTest do
  @moduledoc "The unmodified client of npm in jsdom: what it makes of our diffs and of our server."
  use ExUnit.Case, async: true

  alias Phoenix.LiveView.Diff
  alias Phoenix.LiveViewTest.{JavaScript, Trees}

  @moduletag :node
  @moduletag :tmp_dir
  @moduletag :capture_log

  @pages 30
  @changes 100

  test "the page after each of 3,000 random changes is the page that the server would render", %{
    tmp_dir: folder
  } do
    seed = ExUnit.configuration()[:seed]
    file = Path.join(folder, "trees.jsonl")
    trees = Enum.flat_map(1..@pages, &page(seed * 100_000 + &1 * 1_000))
    assert length(trees) >= 3_000
    File.write!(file, Enum.map_intersperse(trees, "\n", &JSON.encode_to_iodata!/1))
    {output, status} = JavaScript.run("trees.mjs", [file])
    assert status == 0, output
    assert output =~ "#{length(trees)} compared, 0 different"
  end

  defp page(seed) do
    trees = for step <- 0..@changes, do: Trees.pick(Trees.tree(), 5 + rem(step, 30), seed + step)

    changes =
      trees
      |> Enum.chunk_every(2, 1, :discard)
      |> Enum.map(fn [a, b] -> %{diff: Diff.diff(a, b), html: html(b)} end)

    [whole(hd(trees)) | changes]
  end

  defp whole(tree), do: %{full: Diff.root(tree), html: html(tree)}
  defp html(tree), do: tree |> Diff.to_iodata() |> IO.iodata_to_binary()

  test "flows with the running server: joins, events, forms, navigation, crashes, refusals" do
    site = Phoenix.LiveViewTest.Site.start()
    {output, status} = JavaScript.run("flows.mjs", [site.url])
    assert status == 0, output
  end

  @tag :chromium
  test "flows in Chromium" do
    site = Phoenix.LiveViewTest.Site.start(routes: JavaScript.routes())
    {output, status} = JavaScript.run("chromium.mjs", [site.url])
    assert status == 0, output
  end
end
