defmodule MavCodec.Generated.Messages2 do
  use MavCodec.Definition.Shard, messages: {2, 8}
end
