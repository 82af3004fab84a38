Code.require_file("../../bin/lib/checks/growth.exs", __DIR__)

defmodule Aerie.Gate.GrowthTest do
  @moduledoc "How much each app has grown, and commits that add much to lib, in repositories made for each test."

  use ExUnit.Case, async: true

  @moduletag :tmp_dir
  @moduletag skip: if(System.find_executable("git"), do: false, else: "there is no git")

  setup %{tmp_dir: root} do
    # A folder of this checkout is inside its repository.
    git(root, ~w(init --quiet --initial-branch main))
    write(root, "apps/a/lib/a.ex", 10)
    write(root, "apps/a/lib/README.md", 3)
    write(root, "packages/p/bench/b.exs", 2)
    commit(root, "First")
    :ok
  end

  describe "the table" do
    test "has the lines of each app and their difference to the last tag of a release", %{tmp_dir: root} do
      git(root, ~w(tag v0.1.0))
      git(root, ~w(tag other))
      write(root, "apps/a/lib/a.ex", 1_200)
      write(root, "apps/a/test/a_test.exs", 5)
      write(root, "packages/p/bench/b.exs", 1)
      write(root, "docs/x.md", 4)
      # In no release: the simulator, and what benchmarks are made of.
      write(root, "apps/sim_vehicle/lib/sim.ex", 7)
      write(root, "test_kit/bench/support/s.ex", 6)
      commit(root, "Second")

      assert rows(root) == [
               ~w[lines (since v0.1.0) lib tests bench docs],
               ~w[(others) 0 0 0 4 +4],
               ~w[a 1,200 +1,190 5 +5 0 3],
               ~w[p 0 0 1 -1 0],
               ~w[sim_vehicle 0 7 +7 0 0],
               ~w[test_kit 0 0 6 +6 0],
               ~w[all 1,200 +1,190 12 +12 7 +5 7 +4]
             ]
    end

    test "without a tag, the difference is to the commit that gave 0.1.0 its section", %{tmp_dir: root} do
      File.write!(Path.join(root, "CHANGELOG.md"), "# Changelog\n\n## 0.1.0\n")
      commit(root, "Release")
      write(root, "apps/a/lib/a.ex", 11)
      commit(root, "Later")

      assert [["lines", "(since", "0.1.0," | _commit] | rows] = rows(root)
      assert ~w[a 11 +1 0 0 3] in rows
    end

    test "without a release, in a shallow clone or without git, it has today's numbers", %{tmp_dir: root} do
      today = [
        ~w[lines (no release tag) lib tests bench docs],
        ~w[a 10 0 0 3],
        ~w[p 0 0 2 0],
        ~w[all 10 0 2 3]
      ]

      assert rows(root) == today

      commit(root, "Second")
      clone = Path.join(root, "clone")
      git(root, ~w(clone --quiet --depth 1 file://#{root} #{clone}))
      assert rows(clone) == today

      # As git says of a folder that belongs to nobody's repository.
      File.rm_rf!(Path.join(clone, ".git"))
      File.write!(Path.join(clone, ".git"), "gitdir: nowhere")
      assert rows(clone) == today
      assert Growth.problems(clone) == []
    end
  end

  describe "a commit that adds more than 500 lines to lib" do
    setup %{tmp_dir: root} do
      # Nothing before the check is checked.
      write(root, "apps/a/lib/before.ex", 900)
      commit(root, "Before")
      write(root, "bin/lib/checks/growth.exs", 1)
      commit(root, "The check")
      :ok
    end

    test "is refused unless its message says what it deletes", %{tmp_dir: root} do
      write(root, "apps/a/lib/b.ex", 501)
      commit(root, "Much")
      assert [problem] = Growth.problems(root)

      assert problem =~
               ~r/^[0-9a-f]{8} \(Much\): adds 501 lines to lib and does not say what it deletes in return/

      git(root, [
        "commit",
        "--quiet",
        "--amend",
        "-m",
        "Much",
        "-m",
        "Why.\n\nDeletes: the old way, 40 lines."
      ])

      assert Growth.problems(root) == []
    end

    test "is refused unless its change of the changelog says it", %{tmp_dir: root} do
      write(root, "packages/p/lib/b.ex", 501)
      File.write!(Path.join(root, "CHANGELOG.md"), "- Much. Why.\n")
      commit(root, "Much")
      assert [_problem] = Growth.problems(root)

      File.write!(Path.join(root, "CHANGELOG.md"), "- Much. Why.\n  Deletes: the old way.\n")
      git(root, ~w(commit --quiet --all --amend --no-edit))
      assert Growth.problems(root) == []
    end

    test "is named by a later one if it has landed", %{tmp_dir: root} do
      write(root, "apps/a/lib/b.ex", 501)
      commit(root, "Much")
      assert [<<short::binary-8, _rest::binary>>] = Growth.problems(root)

      commit(root, "Another\n\nDeletes: the old way (for 00000000)")
      assert [_problem] = Growth.problems(root)
      commit(root, "Later\n\nDeletes: the old way (for #{short})")
      assert Growth.problems(root) == []
    end

    test "counts what it deletes and moves, and no tests or READMEs", %{tmp_dir: root} do
      write(root, "apps/a/lib/b.ex", 500)
      write(root, "apps/a/test/b_test.exs", 900)
      write(root, "apps/a/lib/b/README.md", 900)
      commit(root, "Little")

      File.mkdir_p!(Path.join(root, "apps/c/lib"))
      File.rename!(Path.join(root, "apps/a/lib/before.ex"), Path.join(root, "apps/c/lib/before.ex"))
      commit(root, "Moved")

      assert Growth.problems(root) == []
    end
  end

  defp rows(root), do: for(line <- root |> Growth.table() |> String.split("\n"), do: String.split(line))

  defp write(root, file, lines) do
    path = Path.join(root, file)
    File.mkdir_p!(Path.dirname(path))
    File.write!(path, String.duplicate("x\n", lines))
  end

  defp commit(root, message) do
    git(root, ~w(add --all))
    git(root, ["commit", "--quiet", "--allow-empty", "-m", message])
  end

  defp git(root, args) do
    who =
      for role <- ["AUTHOR", "COMMITTER"],
          {key, value} <- [{"NAME", "a"}, {"EMAIL", "a@example.org"}],
          do: {"GIT_#{role}_#{key}", value}

    assert {_text, 0} = System.cmd("git", ["-C", root | args], env: who, stderr_to_stdout: true)
  end
end
